/**
 * One published state of a running simulation. Little-endian: sequence (u64), time (f64), generation
 * (u64), rigid motion (7 × f64), n (u32), q (n × f32).
 */

import { toNumber } from './array.js'
import { DecodeError } from './problem.js'

const HEADER_BYTES = 84

/** One published state. */
export interface StateFrame {
  /** Counts published states; gaps are states that were dropped on the way. */
  readonly sequence: number
  /** Simulated time in s. */
  readonly timeSeconds: number
  /** The generation whose basis `q` refers to. */
  readonly generation: number
  /** Rigid motion: position x y z in m, then a unit quaternion x y z w. */
  readonly rigid: Float64Array
  /** Reduced coordinates: a view of the message if its alignment allows (it does). */
  readonly q: Float32Array
}

/** The state that `bytes` holds, all of them. */
export function decodeState(bytes: ArrayBuffer): StateFrame {
  if (bytes.byteLength < HEADER_BYTES) {
    throw new DecodeError(`a state has at least ${HEADER_BYTES} bytes, not ${bytes.byteLength}`)
  }
  const view = new DataView(bytes)
  const n = view.getUint32(80, true)
  if (bytes.byteLength !== HEADER_BYTES + 4 * n) {
    throw new DecodeError(`${bytes.byteLength} bytes do not hold a state of ${n} coordinates`)
  }
  return {
    sequence: toNumber(view.getBigUint64(0, true), 'sequence'),
    timeSeconds: view.getFloat64(8, true),
    generation: toNumber(view.getBigUint64(16, true), 'generation'),
    rigid: new Float64Array(bytes.slice(24, 80)),
    q: new Float32Array(bytes, HEADER_BYTES, n),
  }
}
