/** One session: its edits, the arrays of its generations, its simulation. */

import { expectArray, toNumber } from './array.js'
import type { DType, ElementsOf, NdArray } from './array.js'
import { decodeCombination } from './combination.js'
import type { BlockName, Combination } from './combination.js'
import { decodeEvents } from './events.js'
import type { SessionEvent } from './events.js'
import { FRAME_MEDIA_TYPE, decodeFrame } from './frame.js'
import type { Frame } from './frame.js'
import type { Client, SessionInfo } from './http.js'
import { ProblemError } from './problem.js'
import type { components } from './schema.js'
import { StateStream } from './states.js'

type Schemas = components['schemas']
/** Changes that take effect together or not at all. */
export type EditRequest = Schemas['EditRequest']
/** One change. */
export type Edit = Schemas['Edit']
/** What an edit made. */
export type EditReply = Schemas['EditReply']
/** How a session is simulated. */
export type SimulationConfig = Schemas['SimulationConfig']
/** A running simulation. */
export type SimulationInfo = Schemas['SimulationInfo']
/** A force on one vertex for some time. */
export type Force = Schemas['Force']
/** A damped spring from a vertex to a point in the world. */
export type Grab = Schemas['Grab']
/** Energy, force and stiffness at some coordinates. */
export type Evaluation = Schemas['Evaluation']

/** A generation by its number, or the one that is current when the daemon answers. */
export type Generation = number | 'current'

/** An array of one generation. */
export interface GenerationArray<D extends DType = 'f32'> extends NdArray<ElementsOf<D>> {
  readonly generation: number
}

/** The stitches in force in one generation. */
export interface Stitches {
  readonly generation: number
  /** (s, 2): the two vertices of each. */
  readonly pairs: Uint32Array
  /** Their names, for edits of them. */
  readonly ids: readonly number[]
  /** Their stiffness in N/m. */
  readonly stiffness: Float64Array
}

/** All that is needed to evaluate the reduced model: p points, r coordinates. */
export interface Evaluator<D extends DType = 'f32'> {
  readonly generation: number
  /** The tet of each point. */
  readonly tets: Uint32Array
  /** Cubature weights (p). */
  readonly weights: ElementsOf<D>
  /** Rest volumes in m³ (p). */
  readonly volumes: ElementsOf<D>
  /** Lamé's λ and μ in Pa (p, 2). */
  readonly lame: ElementsOf<D>
  /** Gradients of the four shape functions in 1/m (p, 4, 3). */
  readonly shapeGradients: ElementsOf<D>
  /** Basis rows at the four corners (p, 4, 3, r). */
  readonly basisRows: ElementsOf<D>
  /** Reduced stiffness of the stitches (r, r). */
  readonly stitchStiffness: ElementsOf<D>
  /** The number of reduced coordinates r. */
  readonly size: number
}

/** How arrays may be asked for. */
export interface ArrayOptions<D extends DType> {
  /** Element type; by default `f32`. */
  readonly dtype?: D
  readonly signal?: AbortSignal | undefined
}

/** A session of a daemon. Answers that are no success are thrown as {@link ProblemError}. */
export class Session {
  readonly #client: Client
  readonly #path: string

  constructor(
    client: Client,
    /** Its identifier. */
    readonly id: string,
  ) {
    this.#client = client
    this.#path = `/v1/sessions/${encodeURIComponent(id)}`
  }

  /** What is known of it now. */
  info(signal?: AbortSignal): Promise<SessionInfo> {
    return this.#client.document(this.#path, { signal })
  }

  /** Waits until its build has ended; throws its problem if it failed. */
  async waitReady(onEvent?: (event: SessionEvent) => void): Promise<SessionInfo> {
    const stop = new AbortController()
    try {
      for await (const event of this.events(stop.signal)) {
        onEvent?.(event)
        if (event.event === 'failed') throw new ProblemError(event.error)
        if (event.event === 'deleted') break
        const state = event.event === 'state' ? event.state : undefined
        if (state === 'ready' || state === 'rebuilding') return await this.info()
        if (state === 'failed') break
      }
    } finally {
      stop.abort()
    }
    const info = await this.info()
    if (info.error) throw new ProblemError(info.error)
    return info
  }

  /** Its events: where things stand, then every change, until it ends or `signal` aborts. */
  async *events(signal?: AbortSignal): AsyncGenerator<SessionEvent, void, undefined> {
    const accept = 'text/event-stream'
    const response = await this.#client.request(`${this.#path}/events`, { accept, signal })
    if (response.body) yield* decodeEvents(response.body)
  }

  /** Ends it and everything that runs for it. */
  async delete(): Promise<void> {
    await this.#client.request(this.#path, { method: 'DELETE' })
  }

  /** Opens a session with the same generations, sharing every artifact. */
  async fork(name?: string): Promise<Session> {
    const body = name === undefined ? {} : { name }
    const fork = { method: 'POST', body } as const
    const info = await this.#client.document<SessionInfo>(`${this.#path}/fork`, fork)
    return this.#client.session(info.id)
  }

  /** Makes the next generation. Aborting cancels the edit. */
  edit(request: EditRequest, signal?: AbortSignal): Promise<EditReply> {
    return this.#client.document(`${this.#path}/edits`, { method: 'POST', body: request, signal })
  }

  /** Names candidate pairs, which are then prepared in the background. */
  addSeams(pairs: readonly (readonly [number, number])[]): Promise<Schemas['SeamReply']> {
    return this.#client.document(`${this.#path}/seams`, { method: 'POST', body: { pairs } })
  }

  /** Linear modes (n_modes, n_vertices, 3), mass-normalised. */
  modes<D extends DType = 'f32'>(
    generation: Generation = 'current',
    options: ArrayOptions<D> = {},
  ): Promise<GenerationArray<D>> {
    return this.#array('modes', generation, [null, null, 3], options)
  }

  /** Basis U with UᵀMU = I (r, n_vertices, 3). */
  basis<D extends DType = 'f32'>(
    generation: Generation = 'current',
    options: ArrayOptions<D> = {},
  ): Promise<GenerationArray<D>> {
    return this.#array('basis', generation, [null, null, 3], options)
  }

  /** Rest positions in m (n_vertices, 3), which a closing moves. */
  positions<D extends DType = 'f32'>(
    generation: Generation = 'current',
    options: ArrayOptions<D> = {},
  ): Promise<GenerationArray<D>> {
    return this.#array('positions', generation, [null, 3], options)
  }

  /** Lumped masses in kg (n_vertices). */
  mass<D extends DType = 'f32'>(
    generation: Generation = 'current',
    options: ArrayOptions<D> = {},
  ): Promise<GenerationArray<D>> {
    return this.#array('mass', generation, [null], options)
  }

  /** From the coordinates of the generation `from` to those of `generation` (r_new, r_old). */
  transfer<D extends DType = 'f32'>(
    generation: Generation,
    from: number,
    options: ArrayOptions<D> = {},
  ): Promise<GenerationArray<D>> {
    return this.#array('transfer', generation, [null, null], options, { from })
  }

  /** What a holder of the basis of `have` lacks: the new basis is `[old | columns] · w`. */
  async delta<D extends DType = 'f32'>(
    generation: Generation,
    have: number,
    options: ArrayOptions<D> = {},
  ): Promise<{ columns: GenerationArray<D>; w: GenerationArray<D> }> {
    const frame = await this.frame('delta', generation, options, { have })
    return {
      columns: take<D>(frame, 'columns', options.dtype, [null, null, 3]),
      w: take<D>(frame, 'w', options.dtype, [null, null]),
    }
  }

  /** The basis as a combination of named columns that generations share. */
  async combination(generation: Generation = 'current', signal?: AbortSignal): Promise<Combination> {
    return decodeCombination(await this.frame('combination', generation, { signal }))
  }

  /** The columns of a block (k, n_vertices, 3). */
  block<D extends DType = 'f32'>(
    generation: Generation,
    block: BlockName,
    options: ArrayOptions<D> = {},
  ): Promise<GenerationArray<D>> {
    const blocks = block.id.toString()
    return this.#array('dictionary', generation, [block.nColumns, null, 3], options, { blocks })
  }

  /** The four corners of each tet (n_tets, 4). */
  async tets(generation: Generation = 'current', signal?: AbortSignal): Promise<Uint32Array> {
    const frame = await this.frame('tets', generation, { signal })
    return expectArray('tets', frame.arrays.get('tets'), 'u32', [null, 4]).data as Uint32Array
  }

  /** The stitches in force. */
  async stitches(generation: Generation = 'current', signal?: AbortSignal): Promise<Stitches> {
    const frame = await this.frame('stitches', generation, { dtype: 'f64', signal })
    const pairs = expectArray('pairs', frame.arrays.get('pairs'), 'u32', [null, 2])
    const n = pairs.shape[0] ?? 0
    const halves = expectArray('ids', frame.arrays.get('ids'), 'u32', [n, 2]).data
    const stiffness = take<'f64'>(frame, 'stiffness_n_m', 'f64', [n])
    const id = (i: number) =>
      toNumber(BigInt(halves[2 * i] ?? 0) | (BigInt(halves[2 * i + 1] ?? 0) << 32n), 'stitch')
    return {
      generation: frame.generation,
      pairs: pairs.data as Uint32Array,
      ids: Array.from({ length: n }, (_, i) => id(i)),
      stiffness: stiffness.data,
    }
  }

  /** All that is needed to evaluate the reduced model. */
  async evaluator<D extends DType = 'f32'>(
    generation: Generation = 'current',
    options: ArrayOptions<D> = {},
  ): Promise<Evaluator<D>> {
    const frame = await this.frame('evaluator', generation, options)
    const tets = expectArray('tets', frame.arrays.get('tets'), 'u32', [null]).data as Uint32Array
    const stitches = take<D>(frame, 'stitch_stiffness', options.dtype, [null, null])
    const [p, r] = [tets.length, stitches.shape[0] ?? 0]
    const table = (name: string, shape: number[]) =>
      take<D>(frame, name, options.dtype, shape).data
    return {
      generation: frame.generation,
      tets,
      weights: table('weights', [p]),
      volumes: table('volumes_m3', [p]),
      lame: table('lame_pa', [p, 2]),
      shapeGradients: table('shape_gradients', [p, 4, 3]),
      basisRows: table('basis_rows', [p, 4, 3, r]),
      stitchStiffness: stitches.data,
      size: r,
    }
  }

  /** Energy, force and tangent stiffness of the reduced model at the coordinates `q`. */
  evaluate(
    q: readonly number[],
    { generation, exact = false }: { generation?: Generation; exact?: boolean } = {},
  ): Promise<Evaluation> {
    const at = generation === undefined ? '' : `/generations/${generation}`
    const body = { q, exact }
    return this.#client.document(`${this.#path}${at}/evaluate`, { method: 'POST', body })
  }

  /** Starts the simulation, or changes how it goes on. */
  simulate(config: SimulationConfig = {}): Promise<SimulationInfo> {
    return this.#client.document(`${this.#path}/simulation`, { method: 'PUT', body: config })
  }

  /** The simulation that is running. */
  simulation(signal?: AbortSignal): Promise<SimulationInfo> {
    return this.#client.document(`${this.#path}/simulation`, { signal })
  }

  /** Ends the simulation. */
  async stopSimulation(): Promise<void> {
    await this.#client.request(`${this.#path}/simulation`, { method: 'DELETE' })
  }

  /** Lets forces act on vertices for some time. */
  async pushForces(forces: readonly Force[]): Promise<void> {
    const body = { forces }
    await this.#client.request(`${this.#path}/simulation/forces`, { method: 'POST', body })
  }

  /** Takes hold of vertices, or moves what holds on; lets go of the grabs named in `release`. */
  async grab(grabs: readonly Grab[], release: readonly number[] = []): Promise<void> {
    const path = `${this.#path}/simulation/grabs`
    // What is let go as a page is closed is let go all the same.
    await this.#client.request(path, { method: 'POST', body: { grabs, release }, keepalive: true })
  }

  /** Published states of this and of later simulations, until the session ends. */
  states(): StateStream {
    return new StateStream(...this.#client.socket(`${this.#path}/stream`))
  }

  /** The arrays of `resource`, as a frame. */
  async frame(
    resource: string,
    generation: Generation,
    { dtype, signal }: ArrayOptions<DType> = {},
    query: Record<string, string | number> = {},
  ): Promise<Frame> {
    const path = `${this.#path}/generations/${generation}/${resource}`
    const request = { accept: FRAME_MEDIA_TYPE, query: { dtype: dtype ?? 'f32', ...query }, signal }
    return decodeFrame(await this.#client.bytes(path, request))
  }

  async #array<D extends DType>(
    resource: string,
    generation: Generation,
    shape: (number | null)[],
    options: ArrayOptions<D>,
    query: Record<string, string | number> = {},
  ): Promise<GenerationArray<D>> {
    const frame = await this.frame(resource, generation, options, query)
    return take<D>(frame, resource, options.dtype, shape)
  }
}

function take<D extends DType>(
  frame: Frame,
  name: string,
  dtype: DType | undefined,
  shape: (number | null)[],
): GenerationArray<D> {
  const array = expectArray(name, frame.arrays.get(name), dtype ?? 'f32', shape)
  return { generation: frame.generation, shape: array.shape, data: array.data as ElementsOf<D> }
}
