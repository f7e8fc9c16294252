/** `application/x-npy`: one array in NumPy's format, version 1.0, row-major. */

import { countElements, elementSize, viewElements } from './array.js'
import type { ElementType, NdArray } from './array.js'
import { DecodeError } from './problem.js'

/** Its media type. */
export const NPY_MEDIA_TYPE = 'application/x-npy'

const MAGIC = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0]
const HEADER = /^\{'descr': '<(f4|f8|u4)', 'fortran_order': False, 'shape': \(([\d, ]*)\), \} *\n$/
const TYPES: Record<string, ElementType> = { f4: 'f32', f8: 'f64', u4: 'u32' }

/** The array that `bytes` holds, all of them: a view of `bytes`. */
export function decodeNpy(bytes: Uint8Array): NdArray {
  if (bytes.length < 10 || !MAGIC.every((byte, i) => bytes[i] === byte)) {
    throw new DecodeError('not a NumPy array file of version 1.0')
  }
  const start = 10 + (bytes[8] ?? 0) + 256 * (bytes[9] ?? 0)
  const header = new TextDecoder('latin1').decode(bytes.subarray(10, start))
  const [, descr = '', extents = ''] = HEADER.exec(header) ?? []
  const type = TYPES[descr]
  if (type === undefined) throw new DecodeError(`not the header of a row-major array: ${header}`)
  const shape = extents
    .split(',')
    .filter((extent) => extent.trim() !== '')
    .map(Number)
  const length = countElements(shape)
  if (bytes.length - start !== length * elementSize(type)) {
    throw new DecodeError(`the shape (${extents}) and the number of elements disagree`)
  }
  return { shape, data: viewElements(bytes, type, start, length) }
}
