/** Keeping the basis in step with the generations of a state stream. */

import type { Arrays, Generation } from './arrays.js'
import type { BlockName, Combination } from './combination.js'
import { ProblemError } from './problem.js'
import type { StateFrame } from './state.js'

/** Most bytes of columns held, unless the user says otherwise. */
const MAX_BYTES = 2 ** 30

/** How a tracker holds columns. */
export interface TrackerOptions {
  /** Most bytes of shared columns held. A basis whose columns are more is held whole. */
  readonly maxBytes?: number
  /** Hold columns at these vertices alone, in this order; by default at all. */
  readonly vertices?: Uint32Array
}

/** What displacements are made of: u = Σ coefficient · column. */
export interface Shapes {
  readonly generation: number
  /** The number of reduced coordinates r. */
  readonly size: number
  /** Displacement of every vertex held (3 numbers each), by names that stay the same. */
  readonly columns: readonly { readonly name: string; readonly data: Float32Array }[]
  /** The coefficients of the columns at the reduced coordinates `q`. */
  coefficients(q: ArrayLike<number>): Float64Array
}

/**
 * Turns states into displacements, fetching what a new generation changed when one arrives.
 *
 * It holds blocks of columns that generations share and makes of a new generation's combination what
 * it can: after an edit inside a seam a few tens of kilobytes travel, once the blocks are held. They are
 * many more columns than one basis, so they are fetched when {@link Tracker.prefetch} is called, or else
 * when whole bases have cost as much as they would have.
 */
export class Tracker {
  /** Blocks held, in the order of their arrival: their columns one after the other. */
  readonly #dictionary = new Map<bigint, Float32Array>()
  /** Columns fetched as whole bases since blocks were fetched last. */
  #nSpent = 0
  #blocksInUse: readonly BlockName[] = []
  #shapes!: Shapes
  #following: Promise<void> = Promise.resolve()

  private constructor(
    readonly session: Arrays,
    private readonly options: TrackerOptions,
  ) {}

  /** Fetches the basis of `generation`. */
  static async open(
    session: Arrays,
    options: TrackerOptions = {},
    generation: Generation = 'current',
  ): Promise<Tracker> {
    const tracker = new Tracker(session, options)
    await tracker.#adopt(await session.combination(generation))
    return tracker
  }

  /** The generation in use. */
  get generation(): number {
    return this.#shapes.generation
  }

  /** What displacements of the generation in use are made of. */
  get shapes(): Shapes {
    return this.#shapes
  }

  /** Bytes of shared columns held. */
  get dictionaryBytes(): number {
    return [...this.#dictionary.values()].reduce((sum, columns) => sum + columns.byteLength, 0)
  }

  /** The displacement of every vertex held, in m, at the coordinates `q`; rigid motion aside. */
  reconstruct(q: ArrayLike<number>): Float32Array {
    return combine(this.#shapes.columns, this.#shapes.coefficients(q))
  }

  /** The displacement of every vertex held, in m, at `state`; rigid motion aside. */
  async displacement(state: StateFrame): Promise<Float32Array> {
    if (state.generation !== this.generation) await this.follow(state.generation)
    return this.reconstruct(state.q)
  }

  /** Goes over to the basis of `generation`. Blocks that neither it nor a further edit of it would use
   * are dropped. Calls take their turn. */
  follow(generation: Generation): Promise<void> {
    const turn = this.#following.then(async () => {
      if (generation === this.generation) return
      const combination = await this.session.combination(generation)
      await this.#adopt(combination)
      this.#dropUseless(combination.prepared)
    })
    this.#following = turn.catch(() => undefined)
    return turn
  }

  /**
   * Fetches the blocks that the daemon has prepared for further edits of the current generation, as far as
   * the limit allows; whether all are held now. To be called while nothing else is urgent, and again when
   * more seams have been prepared: edits inside the seams then cost their W alone.
   */
  async prefetch(): Promise<boolean> {
    const combination = await this.session.combination('current')
    this.#dropUseless(combination.prepared)
    for (const block of this.#missing(combination.prepared)) {
      if (this.dictionaryBytes + this.#bytesOf(combination, block.nColumns) <= this.#maxBytes) {
        await this.#fetch(combination.generation, block)
      }
    }
    return this.#missing(combination.prepared).length === 0
  }

  /** Makes displacements of `combination` from now on: of shared columns if those that are missing are
   * no more than the basis has, together with what was spent on whole bases that they would have saved
   * (then never twice what would have been best is fetched); otherwise of the whole basis. */
  async #adopt(combination: Combination): Promise<void> {
    const missing = this.#missing(combination.blocks)
    const nMissing = countColumns(missing)
    const fits = this.#bytesOf(combination, countColumns(combination.blocks)) <= this.#maxBytes
    if (fits && nMissing <= combination.size + this.#nSpent) {
      const keep = ids(this.#blocksInUse, combination.blocks)
      this.#makeRoom(keep, this.#bytesOf(combination, nMissing))
      try {
        for (const block of missing) await this.#fetch(combination.generation, block)
        this.#nSpent = Math.max(0, this.#nSpent - Math.max(0, nMissing - combination.size))
        this.#blocksInUse = combination.blocks
        this.#shapes = this.#combined(combination)
        return
      } catch (error) {
        // The generation has been dropped meanwhile, or a block is larger than may be sent.
        if (!(error instanceof ProblemError && [404, 413].includes(error.status))) throw error
      }
    }
    this.#nSpent += combination.size
    const { generation, data, shape } = await this.session.basis(combination.generation)
    const [size = 0, nVertices = 0] = shape
    const held = this.#restrict(data, size, nVertices)
    const length = held.length / size
    this.#blocksInUse = []
    this.#shapes = {
      generation,
      size,
      columns: Array.from({ length: size }, (_, i) => ({
        name: `generation ${generation}, column ${i}`,
        data: held.subarray(i * length, (i + 1) * length),
      })),
      coefficients: (q) => Float64Array.from(checked(q, size)),
    }
  }

  #combined(combination: Combination): Shapes {
    const { generation, size, w } = combination
    const nHeld = this.options.vertices?.length ?? combination.nVertices
    const columns = combination.columns.map(({ block, place }) => {
      const held = this.#dictionary.get(block)?.subarray(3 * nHeld * place, 3 * nHeld * (place + 1))
      if (held?.length !== 3 * nHeld) throw new Error(`column ${place} of block ${block} is not held`)
      return { name: `block ${block}, column ${place}`, data: held }
    })
    const coefficients = (q: ArrayLike<number>) => {
      checked(q, size)
      const result = new Float64Array(columns.length)
      for (let i = 0; i < result.length; i++) {
        let sum = 0
        for (let j = 0; j < size; j++) sum += (w[i * size + j] ?? 0) * (q[j] ?? 0)
        result[i] = sum
      }
      return result
    }
    return { generation, size, columns, coefficients }
  }

  async #fetch(generation: number, block: BlockName): Promise<void> {
    const { data, shape } = await this.session.block(generation, block)
    this.#dictionary.set(block.id, this.#restrict(data, block.nColumns, shape[1] ?? 0))
  }

  /** `n` columns over all vertices at the vertices that are held. */
  #restrict(columns: Float32Array, n: number, nVertices: number): Float32Array {
    const vertices = this.options.vertices
    if (vertices === undefined) return columns
    const restricted = new Float32Array(3 * n * vertices.length)
    let to = 0
    for (let i = 0; i < n; i++) {
      for (const vertex of vertices) {
        const from = 3 * (i * nVertices + vertex)
        restricted[to++] = columns[from] ?? 0
        restricted[to++] = columns[from + 1] ?? 0
        restricted[to++] = columns[from + 2] ?? 0
      }
    }
    return restricted
  }

  /** Keeps the blocks in use and the `prepared` ones; of these only as many as the limit allows. */
  #dropUseless(prepared: readonly BlockName[]): void {
    const useful = ids(this.#blocksInUse, prepared)
    for (const id of this.#dictionary.keys()) if (!useful.has(id)) this.#dictionary.delete(id)
    this.#makeRoom(ids(this.#blocksInUse), 0)
  }

  /** Drops blocks that are not in `keep`, as many as it takes to fit `nBytes` more below the limit. */
  #makeRoom(keep: ReadonlySet<bigint>, nBytes: number): void {
    // The youngest first: those of the base body's modes, which every edit uses, are the oldest.
    for (const id of [...this.#dictionary.keys()].reverse()) {
      if (this.dictionaryBytes + nBytes <= this.#maxBytes) return
      if (!keep.has(id)) this.#dictionary.delete(id)
    }
  }

  #missing(blocks: readonly BlockName[]): BlockName[] {
    return blocks.filter((block) => !this.#dictionary.has(block.id))
  }

  get #maxBytes(): number {
    return this.options.maxBytes ?? MAX_BYTES
  }

  #bytesOf(combination: Combination, nColumns: number): number {
    return 12 * nColumns * (this.options.vertices?.length ?? combination.nVertices)
  }
}

/** Σ coefficient · column. Sums in double precision: in single precision the rounding of some hundred
 * terms would add up. */
export function combine(columns: Shapes['columns'], coefficients: Float64Array): Float32Array {
  const sums = new Float64Array(columns[0]?.data.length ?? 0)
  columns.forEach(({ data }, i) => {
    const factor = coefficients[i] ?? 0
    if (factor !== 0) for (let k = 0; k < sums.length; k++) sums[k]! += factor * data[k]!
  })
  return Float32Array.from(sums)
}

function checked(q: ArrayLike<number>, size: number): ArrayLike<number> {
  if (q.length !== size) throw new Error(`${q.length} coordinates for a basis of ${size}`)
  return q
}

function countColumns(blocks: readonly BlockName[]): number {
  return blocks.reduce((sum, block) => sum + block.nColumns, 0)
}

function ids(...lists: (readonly BlockName[])[]): Set<bigint> {
  return new Set(lists.flat().map((block) => block.id))
}
