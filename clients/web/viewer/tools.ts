/** What the pointer does on the canvas: turn the camera, pull, or stitch. */

import * as three from 'three'
import type { App } from './app.js'
import { PairState } from './gpu/drawing.js'
import type { Motion } from './motion.js'
import { Signal } from './signal.js'
import type { Stage } from './stage.js'

export type Tool = 'orbit' | 'pull' | 'stitch'

/** Reach of the brush in pixels. */
const BRUSH_RADIUS = 14

export class Tools {
  readonly tool = new Signal<Tool>('orbit')
  /** Pairs under the brush, and whether they are to be stitched or opened. */
  #stroke: { pairs: Set<number>; stitches: boolean } | undefined
  #pull: { start: three.Vector3 } | undefined

  constructor(
    private readonly app: App,
    private readonly stage: Stage,
    private readonly motion: Motion,
  ) {
    const { canvas } = stage
    // Before the camera's own controls, which then leave the pointer alone.
    canvas.addEventListener('pointerdown', (event) => this.#down(event), { capture: true })
    canvas.addEventListener('pointermove', (event) => this.#move(event))
    for (const end of ['pointerup', 'pointercancel'] as const) {
      canvas.addEventListener(end, (event) => this.#up(event))
    }
    this.tool.subscribe((tool) => (canvas.dataset['tool'] = tool))
    app.generation.subscribe(() => this.#showPairs())
  }

  #down(event: PointerEvent): void {
    if (event.button !== 0 || !event.isPrimary || !this.app.body.value) return
    if (this.tool.value === 'pull') {
      const hit = this.stage.pick(event)
      if (!hit) return
      const start = this.stage.toWorld(new three.Vector3(...hit.point))
      this.#pull = { start }
      void this.motion.beginPull(hit.row, start)
    } else if (this.tool.value === 'stitch' && !this.app.isEditing.value) {
      const pair = this.stage.pairAt(event, 1.5 * BRUSH_RADIUS)
      if (pair === undefined) return
      const stitches = !this.app.body.value.stitchedPairs().has(pair)
      this.#stroke = { pairs: new Set([pair]), stitches }
      this.#showPairs()
    }
    if (this.#pull || this.#stroke) {
      this.stage.isOrbiting = false
      this.stage.canvas.setPointerCapture(event.pointerId)
    }
  }

  #move(event: PointerEvent): void {
    if (this.#pull) {
      this.motion.movePull(this.stage.pointerInPlane(event, this.#pull.start))
    } else if (this.#stroke) {
      const pair = this.stage.pairAt(event, BRUSH_RADIUS)
      if (pair === undefined || this.#stroke.pairs.has(pair)) return
      const isStitched = this.app.body.value?.stitchedPairs().has(pair) ?? false
      if (isStitched === this.#stroke.stitches) return
      this.#stroke.pairs.add(pair)
      this.#showPairs()
    }
  }

  #up(event: PointerEvent): void {
    const { canvas } = this.stage
    if (canvas.hasPointerCapture(event.pointerId)) canvas.releasePointerCapture(event.pointerId)
    this.stage.isOrbiting = true
    if (this.#pull) this.motion.endPull()
    this.#pull = undefined
    const stroke = this.#stroke
    this.#stroke = undefined
    if (stroke && event.type === 'pointerup') {
      const pairs = [...stroke.pairs]
      void (stroke.stitches ? this.app.stitch(pairs) : this.app.unstitch(pairs))
    }
    if (stroke) this.#showPairs()
  }

  #showPairs(): void {
    const stitched = this.app.body.value?.stitchedPairs()
    this.stage.setPairStates((pair) => {
      if (this.#stroke?.pairs.has(pair)) return PairState.Touched
      return stitched?.has(pair) ? PairState.Stitched : PairState.Open
    })
  }
}
