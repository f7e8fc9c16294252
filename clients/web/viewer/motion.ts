/**
 * What the body on the stage does: it follows the simulation, swings in its modes, answers to a pull in
 * two bases side by side, or rests.
 */

import * as three from 'three'
import type { Shapes, SimulationConfig, StateFrame, StateStream } from '../client/index.js'
import type { App } from './app.js'
import { bounds } from './body.js'
import type { Body, GenerationData } from './body.js'
import { Signal } from './signal.js'
import type { Stage } from './stage.js'
import { StaticModel, displacementAt } from './statics.js'
import type { Vector } from './statics.js'

/** A pull is a spring so many times as stiff as the body is there: it follows the pointer most of the way. */
const PULL_STIFFNESS = 3
/** Damping of that spring in N·s/m, of its stiffness. */
const PULL_DAMPING_S = 0.02
/** The largest displacement of a mode at full amplitude, of the body's diagonal. */
const MODE_AMPLITUDE = 0.08
/** The largest displacement in a comparison, of the body's diagonal. */
const MAX_STATIC = 0.2
/** The slowest mode is shown at this frequency in Hz, the others in proportion up to the other. */
const MODE_HZ = [0.6, 2.4] as const

/** How long to wait before a connection that broke is made again, in ms. */
const RETRY_INTERVAL = 1000

/** A vertex that is pulled at; places are in the world. */
interface Pull {
  /** Its name among the grabs of the simulation, which others may have hold of, too. */
  readonly id: number
  readonly row: number
  readonly vertex: number
  /** Where the pointer took hold. */
  readonly start: three.Vector3
  /** Where the pointer is. */
  target: three.Vector3
  /** N/m: how hard the body resists there; 0 until that is known. */
  stiffness: number
  /** Whether the daemon has been told; where that is under way, it is told of later places behind it. */
  isSent: boolean
  sending: Promise<void> | undefined
}

/** Two bases under the same load. */
export interface Comparison {
  /** The generation whose basis is on the left. */
  readonly old: GenerationData
  /** How far the vertex pulled at moves, left and right, in m. */
  readonly moved: readonly [number, number]
  /** The pull in N. */
  readonly force: number
}

interface CompareModels {
  readonly old: GenerationData
  readonly oldModel: StaticModel
  readonly newModel: StaticModel
  row: number
  force: Vector
}

export class Motion {
  readonly comparison = new Signal<Comparison | undefined>(undefined)
  /** The latest state of the simulation. */
  readonly state = new Signal<StateFrame | undefined>(undefined)
  /** The pull in N, while there is one. */
  readonly pullForce = new Signal<number | undefined>(undefined)
  /** How hard the pointer pulls. */
  pullStrength = 1
  /** Gravity in m/s², downwards on the screen. */
  gravity = 0
  /** Whether there is a floor below the body. */
  hasFloor = false
  integrator: NonNullable<SimulationConfig['integrator']> = 'implicit_newmark'

  #stream: StateStream | undefined
  #amplitudes: Float64Array | undefined
  #modes: { generation: number; shapes: Shapes; hertz: readonly number[] } | undefined
  #phase = 0
  #lastSeconds = 0
  #models: CompareModels | undefined
  #model: { generation: number; model: Promise<StaticModel> } | undefined
  #pull: Pull | undefined
  #q: ArrayLike<number> = []

  constructor(
    private readonly app: App,
    private readonly stage: Stage,
  ) {
    app.body.subscribe((body) => this.#setBody(body))
    app.generation.subscribe(() => void this.#changeGeneration())
    app.isSimulating.subscribe((running) => {
      if (!running) this.state.value = undefined
      this.#show()
    })
    window.addEventListener('pagehide', () => this.endPull())
    stage.onFrame = (seconds) => this.#swing(seconds)
  }

  /** Starts the simulation, or changes it. */
  simulate(): Promise<boolean> {
    const { point, up } = this.stage.floor()
    const gravity_m_s2 = up.clone().multiplyScalar(-this.gravity).toArray()
    const plane = { point_m: point.toArray(), normal: up.toArray() }
    const obstacles = this.hasFloor ? [{ plane }] : []
    return this.app.simulate({ gravity_m_s2, obstacles, integrator: this.integrator })
  }

  /** Puts a floor below the body, or takes it away. */
  setFloor(there: boolean): void {
    this.hasFloor = there
    this.stage.showFloor(there)
    if (this.app.isSimulating.value) void this.simulate()
  }

  /** Amplitudes of the modes, each from 0 to 1. */
  async setAmplitudes(amplitudes: Float64Array): Promise<void> {
    this.#amplitudes = amplitudes.some((amplitude) => amplitude !== 0) ? amplitudes : undefined
    const generation = this.app.generation.value
    if (this.#amplitudes && this.#modes?.generation !== generation) await this.#fetchModes()
    this.stage.isAnimated =
      this.#amplitudes !== undefined && !matchMedia('(prefers-reduced-motion: reduce)').matches
    this.#show()
  }

  /** Shows the basis of the generation `old` beside the current one, or stops that. */
  async compare(old: number | undefined): Promise<void> {
    const body = this.app.body.value
    if (old === undefined || !body) {
      this.#endComparison()
      return
    }
    try {
      const data = await body.other(old)
      const { session, surface, current } = body
      const [oldModel, newModel] = await Promise.all([
        StaticModel.of(session, surface, data, current.stitches),
        StaticModel.of(session, surface, current),
      ])
      if (this.app.body.value !== body) return
      const load = telling(oldModel, newModel, body)
      this.#models = { old: data, oldModel, newModel, ...load }
      this.stage.setOther(data)
    } catch (error) {
      this.#endComparison()
      this.app.report(error)
    }
    this.#show()
  }

  #endComparison(): void {
    this.#models = undefined
    this.comparison.value = undefined
    this.stage.setOther(undefined)
    this.stage.showPull([])
    this.#show()
  }

  /** Pulls at the vertex of `row`, which the pointer took hold of at `start`. */
  async beginPull(row: number, start: three.Vector3): Promise<void> {
    const body = this.app.body.value
    if (!body) return
    const id = Math.floor(Math.random() * 2 ** 48)
    const vertex = body.surface.vertices[row]!
    const [target, sending] = [start.clone(), undefined]
    const pull: Pull = { id, row, vertex, start, target, stiffness: 0, isSent: false, sending }
    this.#pull = pull
    try {
      if (!this.#models && !this.app.isSimulating.value) {
        if (!(await this.simulate())) return this.endPull()
      }
      const compliance = (await this.#staticModel(body)).compliance(row)
      pull.stiffness = 1 / Math.max(compliance, 1e-12)
    } catch (error) {
      this.app.report(error)
      this.endPull()
    }
    this.#sendPull()
    this.#show()
  }

  /** The pointer is at `target` now. */
  movePull(target: three.Vector3): void {
    if (!this.#pull) return
    this.#pull.target = target
    this.#sendPull()
    this.#show()
  }

  endPull(): void {
    const [pull, session] = [this.#pull, this.app.body.value?.session]
    this.#pull = undefined
    this.pullForce.value = undefined
    if (!this.#models) this.stage.showPull([])
    this.#show()
    if (!pull?.isSent || !session) return
    // Behind what is under way, which would take hold again.
    const release = () => session.grab([], [pull.id])
    Promise.resolve(pull.sending)
      .then(release)
      .catch((error: unknown) => this.app.report(error))
  }

  /** Tells the simulation where the pull is; while it is being told, later places wait, and the last counts. */
  #sendPull(): void {
    const [pull, session] = [this.#pull, this.app.body.value?.session]
    if (!pull || !session || pull.stiffness === 0 || pull.sending || this.#models) return
    const stiffness_n_m = PULL_STIFFNESS * this.pullStrength * pull.stiffness
    const damping_n_s_m = PULL_DAMPING_S * stiffness_n_m
    const { id, vertex, target } = pull
    const target_m: [number, number, number] = [target.x, target.y, target.z]
    pull.isSent = true
    pull.sending = session
      .grab([{ id, vertex, target_m, stiffness_n_m, damping_n_s_m }])
      .catch((error: unknown) => this.app.report(error))
      .finally(() => {
        pull.sending = undefined
        if (this.#pull === pull && !pull.target.equals(target)) this.#sendPull()
      })
  }

  /** The force of a pull as it would hold the body at rest, in N. */
  #staticForce(pull: Pull): Vector {
    const [x, y, z] = pull.target
      .clone()
      .sub(pull.start)
      .multiplyScalar(pull.stiffness * this.pullStrength)
      .toArray()
    return [x, y, z]
  }

  #setBody(body: Body | undefined): void {
    this.#stream?.close()
    this.#stream = undefined
    this.#modes = undefined
    this.#amplitudes = undefined
    this.#models = undefined
    this.#model = undefined
    this.#pull = undefined
    this.comparison.value = undefined
    this.state.value = undefined
    this.stage.isAnimated = false
    this.stage.setBody(body)
    if (body) void this.#listen(body)
  }

  async #changeGeneration(): Promise<void> {
    const body = this.app.body.value
    if (!body || this.app.generation.value === undefined) return
    this.stage.refreshBody()
    if (this.#amplitudes) await this.#fetchModes()
    if (this.#models) {
      const old = this.#models.old.generation
      await this.compare(old === body.current.generation ? undefined : old)
    }
    this.#show()
  }

  /** Follows the states that the daemon publishes, until there is another body. */
  async #listen(body: Body): Promise<void> {
    while (this.app.body.value === body) {
      const stream = body.session.states()
      this.#stream = stream
      try {
        for await (const state of stream) {
          if (this.app.body.value !== body) return
          this.app.noteState()
          this.state.value = state
          this.#show()
        }
      } catch (error) {
        if (this.app.body.value === body) this.app.report(error)
      }
      await new Promise((wake) => setTimeout(wake, RETRY_INTERVAL))
    }
  }

  /** Poses what is on the stage. */
  #show(): void {
    const body = this.app.body.value
    if (!body) return
    if (this.#models) return this.#showComparison(this.#models)
    const state = this.state.value
    const { shapes } = body.current
    if (this.#amplitudes && this.#modes) {
      this.stage.invalidate()
    } else if (this.app.isSimulating.value && state?.generation === shapes.generation) {
      this.#q = state.q
      this.stage.pose('body', shapes, state.q, state.rigid)
    } else if (!this.app.isSimulating.value || state === undefined) {
      this.#q = new Float64Array(shapes.size)
      this.stage.pose('body', shapes, this.#q)
    }
    this.#showPull(body)
  }

  #showPull(body: Body): void {
    const pull = this.#pull
    if (!pull) return
    const { shapes } = body.current
    const u = displacementAt(shapes, pull.row, this.#q)
    const from = this.#at(body, body.current, pull.row, u)
    const to = this.stage.toBody(pull.target)
    const stiffness = PULL_STIFFNESS * this.pullStrength * pull.stiffness
    this.pullForce.value = stiffness * from.distanceTo(to)
    this.stage.showPull([{ from, to }])
  }

  #showComparison(models: CompareModels): void {
    const body = this.app.body.value
    if (!body) return
    const pull = this.#pull
    if (pull && pull.stiffness > 0) {
      models.row = pull.row
      models.force = this.#staticForce(pull)
    }
    // Linear about the rest shape: what moves farther would be shown wrongly.
    const unscaled = newestMoved(models)
    const scale = Math.min(1, (MAX_STATIC * body.diagonal) / Math.max(unscaled, 1e-30))
    models.force = [scale * models.force[0], scale * models.force[1], scale * models.force[2]]
    const { row, force } = models
    const sides = [
      { data: body.current, model: models.newModel, which: 'body' },
      { data: models.old, model: models.oldModel, which: 'other' },
    ] as const
    const ends = sides.map(({ data, model, which }) => {
      const q = model.respond(row, force)
      this.stage.pose(which, data.shapes, q)
      const moved = model.displacement(row, q)
      return { from: this.#at(body, data, row, moved), moved: Math.hypot(...moved) }
    })
    const size = Math.hypot(...force)
    const along = new three.Vector3(...force).setLength(size > 0 ? 0.16 * body.diagonal : 0)
    this.stage.showPull(
      ends.map(({ from }) => ({ from, to: pull ? pull.target : from.clone().add(along) })),
    )
    const moved = [ends[1]!.moved, ends[0]!.moved] as const
    this.comparison.value = { old: models.old, moved, force: size }
  }

  /** Where the vertex of `row` is, displaced by `u`. */
  #at(body: Body, data: GenerationData, row: number, u: Vector): three.Vector3 {
    const vertex = 3 * body.surface.vertices[row]!
    const rest = new three.Vector3(...data.positions.subarray(vertex, vertex + 3))
    return rest.add(new three.Vector3(...u))
  }

  /** Goes on with the swing of the modes. */
  #swing(seconds: number): void {
    const passed = Math.min(0.1, seconds - this.#lastSeconds)
    this.#lastSeconds = seconds
    const [amplitudes, modes] = [this.#amplitudes, this.#modes]
    if (!amplitudes || !modes || this.#models) return
    this.#phase += passed
    const slowest = modes.hertz.find((hertz) => hertz > 0) ?? 1
    const q = Float64Array.from(amplitudes, (amplitude, k) => {
      const hertz = Math.min(MODE_HZ[1], (MODE_HZ[0] * (modes.hertz[k] ?? 0)) / slowest)
      const swing = this.stage.isAnimated ? Math.sin(2 * Math.PI * hertz * this.#phase) : 1
      return amplitude * swing
    })
    this.stage.pose('body', modes.shapes, q.subarray(0, modes.shapes.size))
  }

  async #fetchModes(): Promise<void> {
    const body = this.app.body.value
    const generation = this.app.generation.value
    if (!body || generation === undefined) return
    const { data, shape } = await body.session.modes(generation)
    const [size = 0, nVertices = 0] = shape
    const { vertices } = body.surface
    const columns = Array.from({ length: size }, (_, k) => {
      const column = new Float32Array(3 * vertices.length)
      let largest = 0
      vertices.forEach((vertex, row) => {
        const at = 3 * (k * nVertices + vertex)
        column.set(data.subarray(at, at + 3), 3 * row)
        largest = Math.max(largest, Math.hypot(data[at]!, data[at + 1]!, data[at + 2]!))
      })
      const scale = largest > 0 ? (MODE_AMPLITUDE * body.diagonal) / largest : 0
      return { name: `mode ${k} of ${generation}`, data: column.map((x) => scale * x) }
    })
    const coefficients = (q: ArrayLike<number>) => Float64Array.from(q)
    const hertz = this.app.frequencies.get(generation) ?? []
    this.#modes = { generation, shapes: { generation, size, columns, coefficients }, hertz }
  }

  #staticModel(body: Body): Promise<StaticModel> {
    const { generation } = body.current
    if (this.#model?.generation !== generation) {
      // What floats gives way without end; against its own inertia it does not.
      const slowest = this.app.frequencies.get(generation)?.[0] ?? 1
      const shift = this.app.info.value?.n_rigid_modes ? (2 * Math.PI * slowest) ** 2 : 0
      const { session, surface, current } = body
      const model = StaticModel.of(session, surface, current, current.stitches, shift)
      this.#model = { generation, model }
    }
    return this.#model!.model
  }
}

/** How far the vertex pulled at moves in the rebuilt basis, in m. */
function newestMoved({ newModel, row, force }: CompareModels): number {
  return Math.hypot(...newModel.displacement(row, newModel.respond(row, force)))
}

/** Of some vertices and the two axes along which the body is broad, where a pull shows best that one basis
 * gives way and the other does not; as strong as can be seen well. */
function telling(stiff: StaticModel, soft: StaticModel, body: Body): { row: number; force: Vector } {
  const n = body.surface.vertices.length
  const step = Math.max(1, Math.floor(n / 150))
  const { low, high } = bounds(body.current.positions)
  const extents = low.map((x, axis) => high[axis]! - x)
  const broad = [0, 1, 2].filter((axis) => axis !== extents.indexOf(Math.min(...extents)))
  let best = { row: 0, axis: 0, gain: -Infinity, compliance: 1 }
  for (let row = 0; row < n; row += step) {
    for (const axis of broad) {
      const unit: [number, number, number] = [0, 0, 0]
      unit[axis] = 1
      const [compliance, other] = [soft, stiff].map(
        (model) => model.displacement(row, model.respond(row, unit))[axis]!,
      )
      const gain = compliance! - other!
      if (gain > best.gain) best = { row, axis, gain, compliance: compliance! }
    }
  }
  const force: [number, number, number] = [0, 0, 0]
  force[best.axis] = (0.12 * body.diagonal) / Math.max(best.compliance, 1e-30)
  return { row: best.row, force }
}
