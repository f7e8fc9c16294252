/** Bases as combinations D·W of columns that generations share. */

import { expectArray } from './array.js'
import type { Frame } from './frame.js'
import { DecodeError } from './problem.js'

/** A block of columns by name. */
export interface BlockName {
  /** Names the same columns as long as the daemon runs, and never any others. */
  readonly id: bigint
  readonly nColumns: number
}

/** The basis of a generation as D·W, D being blocks side by side. */
export interface Combination {
  readonly generation: number
  readonly nVertices: number
  /** The number of reduced coordinates r. */
  readonly size: number
  /** The blocks that it is combined of. */
  readonly blocks: readonly BlockName[]
  /** The columns of D that take part: for each its block and its place there. */
  readonly columns: readonly { readonly block: bigint; readonly place: number }[]
  /** W, (number of columns, r). */
  readonly w: Float32Array
  /** The blocks that were prepared for further edits when it was asked for. */
  readonly prepared: readonly BlockName[]
}

/** The combination that `frame` holds. */
export function decodeCombination(frame: Frame): Combination {
  const numbers = (name: string, shape: (number | null)[]) =>
    expectArray(name, frame.arrays.get(name), 'u32', shape).data as Uint32Array
  const blocks = blockNames(numbers('blocks', [null, 2]), numbers('block_sizes', [null]))
  const columns = places(blocks, numbers('columns', [null]))
  const w = expectArray('w', frame.arrays.get('w'), 'f32', [columns.length, null])
  const size = w.shape[1] ?? 0
  if (size > columns.length) throw new DecodeError('"w" has more columns than rows')
  return {
    generation: frame.generation,
    nVertices: numbers('n_vertices', [1])[0] ?? 0,
    size,
    blocks,
    columns,
    w: w.data as Float32Array,
    prepared: blockNames(numbers('prepared', [null, 2]), numbers('prepared_sizes', [null])),
  }
}

function blockNames(halves: Uint32Array, sizes: Uint32Array): BlockName[] {
  const id = (i: number) => BigInt(halves[2 * i] ?? 0) | (BigInt(halves[2 * i + 1] ?? 0) << 32n)
  const blocks = Array.from(sizes, (nColumns, i) => ({ id: id(i), nColumns }))
  if (halves.length !== 2 * sizes.length || new Set(blocks.map((b) => b.id)).size < blocks.length) {
    throw new DecodeError('a combination does not name its blocks')
  }
  return blocks
}

/** Where the columns `used`, which ascend, of all columns side by side are found. */
function places(blocks: readonly BlockName[], used: Uint32Array) {
  let [index, first, last] = [0, 0, -1]
  return Array.from(used, (column) => {
    let block = blocks[index]
    while (block !== undefined && column >= first + block.nColumns) {
      first += block.nColumns
      block = blocks[++index]
    }
    if (block === undefined || column <= last) {
      throw new DecodeError('the columns in use are not columns in order')
    }
    last = column
    return { block: block.id, place: column - first }
  })
}
