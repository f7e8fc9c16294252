/** Named arrays, the currency of frames and .npy files. */

import { DecodeError } from './problem.js'

/** Element types that floating-point arrays can be asked for in. */
export type DType = 'f32' | 'f64'

/** The elements of an array of type `f32`, `f64` or `u32`. */
export type Elements = Float32Array | Float64Array | Uint32Array

/** What elements of `D` are held in. */
export type ElementsOf<D extends DType> = D extends 'f64' ? Float64Array : Float32Array

/** An array, row-major. */
export interface NdArray<T extends Elements = Elements> {
  /** Extent of each axis, the slowest first. */
  readonly shape: readonly number[]
  /** The elements: views of what was received, unless its alignment forbids. */
  readonly data: T
}

const CONSTRUCTORS = { f32: Float32Array, f64: Float64Array, u32: Uint32Array } as const

/** Names of element types. */
export type ElementType = keyof typeof CONSTRUCTORS

/** Bytes of one element. */
export function elementSize(type: ElementType): number {
  return CONSTRUCTORS[type].BYTES_PER_ELEMENT
}

/** Views `length` elements at `offset` of `bytes`; copies them if they are misaligned there. */
export function viewElements(
  bytes: Uint8Array,
  type: ElementType,
  offset: number,
  length: number,
): Elements {
  const size = elementSize(type)
  const start = bytes.byteOffset + offset
  const View = CONSTRUCTORS[type]
  if (start % size === 0) return new View(bytes.buffer as ArrayBuffer, start, length)
  return new View(bytes.slice(offset, offset + length * size).buffer)
}

/** The product of `shape`. */
export function countElements(shape: readonly number[]): number {
  return shape.reduce((product, extent) => product * extent, 1)
}

/** `array` if it holds `type` and has the extents of `shape` (`null`: any), else an error. */
export function expectArray(
  name: string,
  array: NdArray | undefined,
  type: ElementType,
  shape: readonly (number | null)[],
): NdArray {
  if (array === undefined) throw new DecodeError(`array "${name}" is missing`)
  const fits =
    array.shape.length === shape.length &&
    shape.every((extent, axis) => extent === null || extent === array.shape[axis])
  if (!fits || !(array.data instanceof CONSTRUCTORS[type])) {
    const wanted = shape.map((extent) => extent ?? '*').join(', ')
    throw new DecodeError(`array "${name}" is (${array.shape.join(', ')}), not ${type} (${wanted})`)
  }
  return array
}

/** Numbers as indices of JavaScript: the daemon's u64, of which only 53 bits are ever used. */
export function toNumber(value: bigint, what: string): number {
  const number = Number(value)
  if (!Number.isSafeInteger(number)) throw new DecodeError(`${what} ${value} is too large`)
  return number
}
