/**
 * `application/vnd.sutura.frame`: named arrays in one block of bytes.
 *
 * Little-endian: the mark `SUTURA\x01\0`, the generation (u64), the number of arrays (u64), for each
 * its name (length as u64, UTF-8), its type (u32: 0 = f32, 1 = f64, 2 = u32) and its extents (their
 * number, then each, as u64); then the arrays, each at the next multiple of 8 bytes.
 */

import { countElements, elementSize, toNumber, viewElements } from './array.js'
import type { ElementType, NdArray } from './array.js'
import { DecodeError } from './problem.js'

/** Its media type. */
export const FRAME_MEDIA_TYPE = 'application/vnd.sutura.frame'

const MAGIC = [0x53, 0x55, 0x54, 0x55, 0x52, 0x41, 1, 0]
const MAX_ARRAYS = 32
const MAX_RANK = 4
const MAX_NAME_BYTES = 64
const TYPES: readonly ElementType[] = ['f32', 'f64', 'u32']

/** Arrays that belong to one generation. */
export interface Frame {
  readonly generation: number
  readonly arrays: ReadonlyMap<string, NdArray>
}

/** The frame that `bytes` holds, all of them. Its arrays are views of `bytes`. */
export function decodeFrame(bytes: Uint8Array): Frame {
  if (!MAGIC.every((byte, i) => bytes[i] === byte)) {
    throw new DecodeError('the bytes do not start with the mark of a version 1 frame')
  }
  const header = new Header(bytes, MAGIC.length)
  const generation = toNumber(header.u64(), 'generation')
  const described = Array.from({ length: header.count(MAX_ARRAYS, 'arrays') }, () => ({
    name: header.text(header.count(MAX_NAME_BYTES, 'bytes of a name')),
    type: header.type(),
    shape: Array.from({ length: header.count(MAX_RANK, 'axes') }, () =>
      toNumber(header.u64(), 'extent'),
    ),
  }))
  const arrays = new Map<string, NdArray>()
  let end = header.end
  for (const { name, type, shape } of described) {
    if (arrays.has(name)) throw new DecodeError(`two arrays are named "${name}"`)
    const start = Math.ceil(end / 8) * 8
    const length = countElements(shape)
    end = start + length * elementSize(type)
    if (!(end <= bytes.length)) throw new DecodeError(`array "${name}" is cut off`)
    arrays.set(name, { shape, data: viewElements(bytes, type, start, length) })
  }
  if (end !== bytes.length) {
    throw new DecodeError(`a frame of ${end} bytes is announced, but there are ${bytes.length}`)
  }
  return { generation, arrays }
}

/** Reads the header member by member. */
class Header {
  readonly #bytes: Uint8Array
  readonly #view: DataView

  constructor(
    bytes: Uint8Array,
    public end: number,
  ) {
    this.#bytes = bytes
    this.#view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength)
  }

  u64(): bigint {
    return this.#view.getBigUint64(this.#take(8), true)
  }

  type(): ElementType {
    const code = this.#view.getUint32(this.#take(4), true)
    const type = TYPES[code]
    if (type === undefined) throw new DecodeError(`there is no element type ${code}`)
    return type
  }

  count(limit: number, what: string): number {
    const count = this.u64()
    if (count > limit) throw new DecodeError(`${count} ${what}, at most ${limit}`)
    return Number(count)
  }

  text(length: number): string {
    const start = this.#take(length)
    try {
      const utf8 = new TextDecoder('utf-8', { fatal: true })
      return utf8.decode(this.#bytes.subarray(start, start + length))
    } catch {
      throw new DecodeError('the name of an array is not UTF-8')
    }
  }

  /** Goes on by `n` bytes; where they begin. */
  #take(n: number): number {
    const start = this.end
    this.end += n
    if (this.end > this.#bytes.length) throw new DecodeError("the frame's header is cut off")
    return start
  }
}
