/** The arrays of a session's generations, whatever brings them. */

import { expectArray, toNumber } from './array.js'
import type { DType, ElementsOf, NdArray } from './array.js'
import { decodeCombination } from './combination.js'
import type { BlockName, Combination } from './combination.js'
import type { Frame } from './frame.js'

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
  /** Basis rows at the four corners, or those of an affine displacement that has the point's gradient (p, 4, 3, r). */
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

/** Whatever has the arrays of a session. */
export abstract class Arrays {
  /** The arrays of `resource`, as a frame. */
  abstract frame(
    resource: string,
    generation: Generation,
    options?: ArrayOptions<DType>,
    query?: Record<string, string | number>,
  ): Promise<Frame>

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

  /** Frequencies of the elastic modes in Hz, ascending (n_modes). */
  async frequencies(generation: Generation = 'current', signal?: AbortSignal): Promise<Float64Array> {
    const frame = await this.frame('frequencies_hz', generation, { dtype: 'f64', signal })
    return take<'f64'>(frame, 'frequencies_hz', 'f64', [null]).data
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
