/** The canvas: cameras, bodies side by side, frames, and what is under the pointer. */

import * as three from 'three'
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js'
import type { Shapes } from '../client/index.js'
import { bounds } from './body.js'
import type { Body, GenerationData } from './body.js'
import { Deformation } from './gpu/deformation.js'
import { Drawing, PairState } from './gpu/drawing.js'
import type { Palette } from './gpu/drawing.js'
import { castRay } from './gpu/picking.js'
import type { Hit } from './gpu/picking.js'
import { Signal } from './signal.js'

// Colours are those of the page; nothing is lit in linear light.
three.ColorManagement.enabled = false

/** What is marked on a body. */
export interface Marks {
  pairs: boolean
  cubature: boolean
  held: boolean
  displacement: boolean
}

/** One body on the stage, at some coordinates. */
class Actor {
  readonly scene = new three.Scene()
  floor: three.GridHelper | undefined
  readonly deformation: Deformation
  readonly drawing: Drawing
  #q: ArrayLike<number> = []
  #isStale = true

  constructor(body: Body, data: GenerationData, maxTextureSize: number) {
    this.deformation = new Deformation(body.surface, data.positions, maxTextureSize)
    this.drawing = new Drawing(body.surface, body.pairs, this.deformation, body.diagonal)
    this.scene.add(this.drawing.group)
    this.pose(data.shapes, new Float64Array(data.shapes.size))
  }

  pose(shapes: Shapes, q: ArrayLike<number>): void {
    this.deformation.setShapes(shapes)
    this.#q = q
    this.#isStale = true
  }

  /** Body coordinates follow `rigid`: position, then quaternion. */
  place(rigid: ArrayLike<number> | undefined): void {
    const [x, y, z, a, b, c, w] = Array.from(rigid ?? [0, 0, 0, 0, 0, 0, 1])
    this.drawing.group.position.set(x!, y!, z!)
    this.drawing.group.quaternion.set(a!, b!, c!, w!)
    this.drawing.group.updateMatrixWorld()
  }

  refresh(renderer: three.WebGLRenderer): void {
    if (!this.#isStale) return
    this.#isStale = false
    this.deformation.update(renderer, this.#q)
    this.drawing.moveTo(this.#q)
  }

  markStale(): void {
    this.#isStale = true
  }

  dispose(): void {
    this.floor?.dispose()
    this.deformation.dispose()
    this.drawing.dispose()
  }
}

/** Frame times kept for the display. */
const N_FRAME_TIMES = 120

export class Stage {
  /** Medians and worst of the latest frame intervals in ms, while something moves. */
  readonly frameTime = new Signal<{ median: number; worst: number } | undefined>(undefined)
  /** Called before every frame, with the time since the page was opened, in s. */
  onFrame: ((seconds: number) => void) | undefined
  /** Whether frames go on without anybody asking. */
  isAnimated = false

  readonly #renderer: three.WebGLRenderer
  readonly #camera = new three.PerspectiveCamera(32, 1, 0.001, 100)
  #controls: OrbitControls
  readonly #maxTextureSize: number
  readonly #intervals: number[] = []
  #actor: Actor | undefined
  #other: Actor | undefined
  #body: Body | undefined
  #palette: Palette
  #marks: Marks = { pairs: true, cubature: false, held: false, displacement: false }
  #pairState: (pair: number) => PairState = () => PairState.Open
  #hasFloor = false
  #isRequested = false
  #lastFrame = 0

  constructor(
    readonly canvas: HTMLCanvasElement,
    palette: Palette,
  ) {
    this.#palette = palette
    // Without a graphics card, smooth edges would cost more than everything else.
    const antialias = !drawsInSoftware()
    this.#renderer = new three.WebGLRenderer({ canvas, antialias, alpha: true })
    this.#renderer.outputColorSpace = three.LinearSRGBColorSpace
    this.#renderer.autoClear = false
    if (!this.#renderer.extensions.has('EXT_color_buffer_float')) {
      throw new Error('this browser cannot render to floating-point textures (WebGL 2)')
    }
    this.#maxTextureSize = this.#renderer.capabilities.maxTextureSize
    this.#controls = this.#newControls()
    canvas.addEventListener('webglcontextrestored', () => {
      for (const actor of [this.#actor, this.#other]) actor?.markStale()
      this.#redress()
    })
    new ResizeObserver(() => this.#resize()).observe(canvas)
  }

  /** Puts `body` on the stage, or clears it. */
  setBody(body: Body | undefined): void {
    this.setOther(undefined)
    this.#actor?.dispose()
    this.#actor = undefined
    this.#body = body
    this.canvas.style.visibility = body ? 'visible' : 'hidden'
    if (body) {
      this.#actor = new Actor(body, body.current, this.#maxTextureSize)
      this.#dress(this.#actor, body.current)
      this.lookAtBody()
    }
    this.invalidate()
  }

  /** The body's generation has changed: its rest shape, its marks. */
  refreshBody(): void {
    if (!this.#body || !this.#actor) return
    const data = this.#body.current
    this.#actor.deformation.setRest(this.#body.surface, data.positions)
    this.#dress(this.#actor, data)
    this.invalidate()
  }

  /** Shows `data` beside the body, to its left. */
  setOther(data: GenerationData | undefined): void {
    if (!this.#other && !data) return
    this.#other?.dispose()
    this.#other = undefined
    if (data && this.#body) {
      this.#other = new Actor(this.#body, data, this.#maxTextureSize)
      this.#dress(this.#other, data)
    }
    const before = this.#distanceFor(1)
    this.#resize()
    this.orbit(0, 0, before / this.#distanceFor(1))
  }

  /** Shows the body, or what is beside it, at the coordinates `q`. */
  pose(
    which: 'body' | 'other',
    shapes: Shapes,
    q: ArrayLike<number>,
    rigid?: ArrayLike<number>,
  ): void {
    const actor = which === 'body' ? this.#actor : this.#other
    actor?.pose(shapes, q)
    actor?.place(rigid)
    this.invalidate()
  }

  setMarks(marks: Marks): void {
    this.#marks = marks
    this.#redress()
  }

  setPalette(palette: Palette): void {
    this.#palette = palette
    this.#redress()
  }

  setPairStates(stateOf: (pair: number) => PairState): void {
    this.#pairState = stateOf
    for (const actor of [this.#actor, this.#other]) actor?.drawing.setPairStates(stateOf)
    this.invalidate()
  }

  /** Draws a pull in every view, or none. */
  showPull(ends: { from: three.Vector3; to: three.Vector3 }[]): void {
    this.#actor?.drawing.showPull(ends[0])
    this.#other?.drawing.showPull(ends[1])
    this.invalidate()
  }

  /** Looks at the whole body from where it is broad. */
  lookAtBody(): void {
    if (!this.#body) return
    const { low, high, centre, diagonal } = bounds(this.#body.current.positions)
    const extents = [0, 1, 2].map((axis) => high[axis]! - low[axis]!)
    const isFlat = extents[1] === Math.min(...extents)
    const up = isFlat ? new three.Vector3(0, 0, 1) : new three.Vector3(0, 1, 0)
    const from = isFlat ? new three.Vector3(0.35, -0.9, 0.25) : new three.Vector3(0.35, 0.25, 0.9)
    if (!isFlat && extents[0]! < extents[2]!) from.set(0.9, 0.25, 0.35)
    if (!this.#camera.up.equals(up)) {
      this.#camera.up.copy(up)
      this.#controls.dispose()
      this.#controls = this.#newControls()
    }
    const distance = this.#distanceFor(diagonal)
    this.#controls.target.set(...centre)
    this.#camera.position.set(...centre).add(from.setLength(distance))
    this.#camera.near = distance / 100
    this.#camera.far = distance * 10
    this.#camera.updateProjectionMatrix()
    this.#controls.update()
    this.invalidate()
  }

  /** Controls for the camera, whose direction upwards they keep. */
  #newControls(): OrbitControls {
    const controls = new OrbitControls(this.#camera, this.canvas)
    controls.enableDamping = true
    controls.dampingFactor = 0.12
    controls.addEventListener('change', () => this.invalidate())
    return controls
  }

  /** Where a floor would be: just below the body at rest, as it was looked at last. */
  floor(): { point: three.Vector3; up: three.Vector3 } {
    const up = this.#camera.up.clone()
    if (!this.#body) return { point: new three.Vector3(), up }
    const { low, centre, diagonal } = bounds(this.#body.current.positions)
    const point = new three.Vector3(...centre)
    const lowest = new three.Vector3(...low).dot(up) - 0.02 * diagonal
    return { point: point.addScaledVector(up, lowest - point.dot(up)), up }
  }

  /** Draws the floor, or no longer. */
  showFloor(show: boolean): void {
    this.#hasFloor = show
    for (const actor of [this.#actor, this.#other]) if (actor) this.#layFloor(actor)
    this.invalidate()
  }

  #layFloor(actor: Actor): void {
    actor.floor?.removeFromParent()
    actor.floor?.dispose()
    actor.floor = undefined
    if (!this.#hasFloor || !this.#body) return
    const { point, up } = this.floor()
    const grid = new three.GridHelper(2 * this.#body.diagonal, 20, this.#palette.held, this.#palette.held)
    grid.material.transparent = true
    grid.material.opacity = 0.35
    grid.quaternion.setFromUnitVectors(new three.Vector3(0, 1, 0), up)
    grid.position.copy(point)
    actor.floor = grid
    actor.scene.add(grid)
  }

  /** How far the camera must be for a sphere of this diameter to fit, nearly. */
  #distanceFor(diameter: number): number {
    const halfAngle = ((this.#camera.fov / 2) * Math.PI) / 180
    return (0.52 * diameter) / (Math.tan(halfAngle) * Math.min(1, this.#camera.aspect))
  }

  /** Turns the camera about the body by angles in radians, and brings it nearer by a factor. */
  orbit(right: number, up: number, nearer = 1): void {
    const upright = new three.Quaternion().setFromUnitVectors(
      this.#camera.up,
      new three.Vector3(0, 1, 0),
    )
    const offset = this.#camera.position.clone().sub(this.#controls.target)
    const spherical = new three.Spherical().setFromVector3(offset.applyQuaternion(upright))
    spherical.theta -= right
    spherical.phi -= up
    spherical.radius /= nearer
    spherical.makeSafe()
    offset.setFromSpherical(spherical).applyQuaternion(upright.invert())
    this.#camera.position.copy(offset).add(this.#controls.target)
    this.#controls.update()
    this.invalidate()
  }

  /** Whether dragging turns the camera. */
  set isOrbiting(enabled: boolean) {
    this.#controls.enabled = enabled
  }

  /** What of the body is under the pointer. */
  pick(event: { clientX: number; clientY: number }): Hit | undefined {
    const actor = this.#actor
    if (!actor || !this.#body) return undefined
    actor.refresh(this.#renderer)
    const ray = this.#ray(event, actor)
    const positions = actor.deformation.read(this.#renderer)
    return castRay(
      ray.origin.toArray(),
      ray.direction.toArray(),
      positions,
      this.#body.surface.triangles,
    )
  }

  /** The visible pair nearest to the pointer, within `radius` pixels. */
  pairAt(event: { clientX: number; clientY: number }, radius: number): number | undefined {
    const [actor, body] = [this.#actor, this.#body]
    if (!actor || !body || body.pairs.length === 0) return undefined
    actor.refresh(this.#renderer)
    const positions = actor.deformation.read(this.#renderer)
    const ray = this.#ray(event, actor)
    const hit = castRay(
      ray.origin.toArray(),
      ray.direction.toArray(),
      positions,
      body.surface.triangles,
    )
    const pointer = this.#toView(event)
    const { width, height } = this.#viewport(event)
    const matrix = this.#camera.projectionMatrix
      .clone()
      .multiply(this.#camera.matrixWorldInverse)
      .multiply(actor.drawing.group.matrixWorld)
    const place = new three.Vector3()
    let [best, found]: [number, number | undefined] = [radius, undefined]
    for (let i = 0; i < body.pairs.length / 2; i++) {
      const a = 4 * body.surface.rowOf[body.pairs[2 * i]!]!
      const b = 4 * body.surface.rowOf[body.pairs[2 * i + 1]!]!
      place.set(
        (positions[a]! + positions[b]!) / 2,
        (positions[a + 1]! + positions[b + 1]!) / 2,
        (positions[a + 2]! + positions[b + 2]!) / 2,
      )
      const depth = place.distanceTo(ray.origin)
      if (hit && depth > hit.distance + 0.06 * body.diagonal) continue
      place.applyMatrix4(matrix)
      const dx = ((place.x - pointer.x) * width) / 2
      const dy = ((place.y - pointer.y) * height) / 2
      const distance = Math.hypot(dx, dy)
      if (distance < best) [best, found] = [distance, i]
    }
    return found
  }

  /** Where on the screen the middle of a pair is, in pixels of the page. */
  pairOnScreen(pair: number): { x: number; y: number } | undefined {
    const [actor, body] = [this.#actor, this.#body]
    if (!actor || !body) return undefined
    actor.refresh(this.#renderer)
    const positions = actor.deformation.read(this.#renderer)
    const row = 4 * body.surface.rowOf[body.pairs[2 * pair]!]!
    const place = new three.Vector3(...positions.subarray(row, row + 3))
    place.applyMatrix4(actor.drawing.group.matrixWorld).project(this.#camera)
    const { left, top, width, height } = this.canvas.getBoundingClientRect()
    return { x: left + ((place.x + 1) / 2) * width, y: top + ((1 - place.y) / 2) * height }
  }

  /** Where the pointer is in the plane through `anchor` that faces the camera, in the world. */
  pointerInPlane(
    event: { clientX: number; clientY: number },
    anchor: three.Vector3,
  ): three.Vector3 {
    const facing = this.#camera.getWorldDirection(new three.Vector3())
    const plane = new three.Plane().setFromNormalAndCoplanarPoint(facing, anchor)
    const caster = new three.Raycaster()
    caster.setFromCamera(this.#toView(event), this.#camera)
    return caster.ray.intersectPlane(plane, new three.Vector3()) ?? anchor.clone()
  }

  /** A point of the body in the world. */
  toWorld(point: three.Vector3): three.Vector3 {
    return this.#actor?.drawing.group.localToWorld(point.clone()) ?? point
  }

  /** A point of the world in the frame of the body. */
  toBody(point: three.Vector3): three.Vector3 {
    return this.#actor?.drawing.group.worldToLocal(point.clone()) ?? point
  }

  /** Draws a frame soon. */
  invalidate(): void {
    if (this.#isRequested) return
    this.#isRequested = true
    requestAnimationFrame((now) => this.#frame(now))
  }

  #frame(now: number): void {
    this.#measure(now)
    this.onFrame?.(now / 1000)
    this.#isRequested = false
    this.#controls.update()
    const [actor, other] = [this.#actor, this.#other]
    const renderer = this.#renderer
    actor?.refresh(renderer)
    other?.refresh(renderer)
    const { clientWidth: width, clientHeight: height } = this.canvas
    renderer.setScissorTest(false)
    renderer.clear()
    if (actor && other) {
      renderer.setScissorTest(true)
      const half = Math.floor(width / 2)
      ;[other, actor].forEach(({ scene }, i) => {
        renderer.setViewport(i * half, 0, half, height)
        renderer.setScissor(i * half, 0, half, height)
        renderer.render(scene, this.#camera)
      })
    } else if (actor) {
      renderer.setViewport(0, 0, width, height)
      renderer.render(actor.scene, this.#camera)
    }
    if (this.isAnimated) this.invalidate()
  }

  #measure(now: number): void {
    const interval = now - this.#lastFrame
    this.#lastFrame = now
    // A longer pause is one in which nothing moved.
    if (interval > 1000) {
      this.#intervals.length = 0
      return
    }
    this.#intervals.push(interval)
    if (this.#intervals.length > N_FRAME_TIMES) this.#intervals.shift()
    if (this.#intervals.length % 15 === 0) {
      const sorted = [...this.#intervals].sort((a, b) => a - b)
      const median = sorted[Math.floor(sorted.length / 2)]!
      this.frameTime.value = { median, worst: sorted.at(-1)! }
    }
  }

  #resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas
    if (width === 0 || height === 0) return
    this.#renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2))
    this.#renderer.setSize(width, height, false)
    this.#camera.aspect = (this.#other ? width / 2 : width) / height
    this.#camera.updateProjectionMatrix()
    this.#redress()
  }

  #dress(actor: Actor, data: GenerationData): void {
    this.#layFloor(actor)
    actor.drawing.setPalette(this.#palette, Math.min(window.devicePixelRatio, 2))
    actor.drawing.showPairs(this.#marks.pairs)
    actor.drawing.showDisplacement(this.#marks.displacement)
    actor.drawing.setPairStates(this.#pairState)
    actor.drawing.setCubature(data.cubature, this.#marks.cubature)
    actor.drawing.setHeld(this.#marks.held ? (this.#body?.heldRows() ?? new Uint32Array()) : new Uint32Array(), this.#marks.held)
    actor.markStale()
  }

  #redress(): void {
    if (this.#actor && this.#body) this.#dress(this.#actor, this.#body.current)
    if (this.#other && this.#body) {
      this.#other.drawing.setPalette(this.#palette, Math.min(window.devicePixelRatio, 2))
      this.#other.drawing.showDisplacement(this.#marks.displacement)
      this.#other.drawing.showPairs(this.#marks.pairs)
    }
    this.invalidate()
  }

  /** The part of the canvas in which the body is. */
  #viewport({ clientX }: { clientX: number }): DOMRect {
    const { left, top, width, height } = this.canvas.getBoundingClientRect()
    if (!this.#other) return new DOMRect(left, top, width, height)
    const half = width / 2
    return new DOMRect(clientX < left + half ? left : left + half, top, half, height)
  }

  #toView(event: { clientX: number; clientY: number }): three.Vector2 {
    const { left, top, width, height } = this.#viewport(event)
    const x = (event.clientX - left) / width
    return new three.Vector2(2 * x - 1, 1 - (2 * (event.clientY - top)) / height)
  }

  /** The ray under the pointer in the frame of `actor`. */
  #ray(event: { clientX: number; clientY: number }, actor: Actor): three.Ray {
    const caster = new three.Raycaster()
    this.#camera.updateMatrixWorld()
    caster.setFromCamera(this.#toView(event), this.#camera)
    return caster.ray.applyMatrix4(actor.drawing.group.matrixWorld.clone().invert())
  }
}

/** Whether the browser draws without a graphics card. */
function drawsInSoftware(): boolean {
  const context = document.createElement('canvas').getContext('webgl2')
  const names = context?.getExtension('WEBGL_debug_renderer_info')
  const name: unknown = names && context?.getParameter(names.UNMASKED_RENDERER_WEBGL)
  context?.getExtension('WEBGL_lose_context')?.loseContext()
  return typeof name === 'string' && /swiftshader|llvmpipe|softpipe|software/i.test(name)
}
