/** Bytes from outside: frames, .npy files, states, events. */

import assert from 'node:assert/strict'
import { test } from 'node:test'
import {
  DecodeError,
  boundaryTriangles,
  coincidentPairs,
  decodeFrame,
  decodeNpy,
  decodeState,
} from '../build/index.js'
import { decodeEvents } from '../build/events.js'
import { bar } from './bodies.mjs'

/** A frame of arrays [name, type code, shape, elements]. */
function encodeFrame(generation, arrays) {
  const parts = [Buffer.from('SUTURA\x01\0', 'latin1'), u64(generation), u64(arrays.length)]
  for (const [name, type, shape] of arrays) {
    parts.push(u64(name.length), Buffer.from(name), u32(type), u64(shape.length), ...shape.map(u64))
  }
  let bytes = Buffer.concat(parts)
  for (const [, , , elements] of arrays) {
    const padding = Buffer.alloc((8 - (bytes.length % 8)) % 8)
    bytes = Buffer.concat([bytes, padding, Buffer.from(elements.buffer)])
  }
  return new Uint8Array(bytes)
}

function u64(value) {
  const bytes = Buffer.alloc(8)
  bytes.writeBigUInt64LE(BigInt(value))
  return bytes
}

function u32(value) {
  const bytes = Buffer.alloc(4)
  bytes.writeUInt32LE(value)
  return bytes
}

const FRAME = encodeFrame(7, [
  ['a', 0, [1, 3], Float32Array.of(1, 2, 3)],
  ['b', 1, [2], Float64Array.of(0.1, -0.2)],
  ['c', 2, [0, 4], new Uint32Array()],
])

test('frames are viewed, not copied', () => {
  const { generation, arrays } = decodeFrame(FRAME)
  assert.equal(generation, 7)
  assert.deepEqual(arrays.get('a'), { shape: [1, 3], data: Float32Array.of(1, 2, 3) })
  assert.deepEqual(arrays.get('b').data, Float64Array.of(0.1, -0.2))
  assert.deepEqual(arrays.get('c').shape, [0, 4])
  for (const { data } of arrays.values()) assert.equal(data.buffer, FRAME.buffer)
})

test('a frame that is misaligned in memory is read all the same', () => {
  const shifted = new Uint8Array(FRAME.length + 1)
  shifted.set(FRAME, 1)
  assert.deepEqual(decodeFrame(shifted.subarray(1)), decodeFrame(FRAME))
})

test('every cut and many changes of a frame are errors, never crashes', () => {
  for (let length = 0; length < FRAME.length; length++) {
    assert.throws(() => decodeFrame(FRAME.subarray(0, length)), DecodeError, `${length} bytes`)
  }
  for (let at = 0; at < 90; at++) {
    const hostile = Uint8Array.from(FRAME)
    hostile[at] ^= 0xff
    try {
      decodeFrame(hostile)
    } catch (error) {
      assert.ok(error instanceof DecodeError, `byte ${at}: ${error.stack}`)
    }
  }
})

test('.npy files are viewed where they are aligned', () => {
  const header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 1), }".padEnd(117) + '\n'
  const magic = Buffer.from('\x93NUMPY\x01\0', 'latin1')
  const head = Buffer.concat([magic, Buffer.from([118, 0]), Buffer.from(header)])
  const bytes = new Uint8Array(Buffer.concat([head, Buffer.from(Float32Array.of(4, 5).buffer)]))
  assert.deepEqual(decodeNpy(bytes), { shape: [2, 1], data: Float32Array.of(4, 5) })
  assert.equal(decodeNpy(bytes).data.buffer, bytes.buffer)
  for (let length = 0; length < bytes.length; length++) {
    assert.throws(() => decodeNpy(bytes.subarray(0, length)), DecodeError)
  }
  const fortran = Uint8Array.from(Buffer.from(Buffer.from(bytes).toString('latin1').replace('False', 'True '), 'latin1'))
  assert.throws(() => decodeNpy(fortran), DecodeError)
})

test('states are read whole or not at all', () => {
  const bytes = new ArrayBuffer(84 + 8)
  const view = new DataView(bytes)
  view.setBigUint64(0, 3n, true)
  view.setFloat64(8, 0.5, true)
  view.setBigUint64(16, 2n, true)
  view.setFloat64(24 + 48, 1, true)
  view.setUint32(80, 2, true)
  view.setFloat32(88, -1.5, true)
  const state = decodeState(bytes)
  assert.deepEqual(state.q, Float32Array.of(0, -1.5))
  assert.deepEqual([state.sequence, state.timeSeconds, state.generation], [3, 0.5, 2])
  assert.deepEqual([...state.rigid], [0, 0, 0, 0, 0, 0, 1])
  assert.throws(() => decodeState(bytes.slice(0, 83)), DecodeError)
  assert.throws(() => decodeState(bytes.slice(0, 88)), DecodeError)
})

test('events come whole, however they are cut', async () => {
  const text = ': hello\n\nevent: stage\ndata: {"event":"stage","stage":"modes","progress":0.5}\n\n' +
    'event: deleted\ndata: {"event":"deleted"}\n\n'
  for (const size of [1, 7, 1000]) {
    const pieces = new ReadableStream({
      start(controller) {
        const bytes = new TextEncoder().encode(text)
        for (let i = 0; i < bytes.length; i += size) controller.enqueue(bytes.slice(i, i + size))
        controller.close()
      },
    })
    const events = []
    for await (const event of decodeEvents(pieces)) events.push(event.event)
    assert.deepEqual(events, ['stage', 'deleted'])
  }
})

test('the surface of a bar is closed and looks outwards', () => {
  const { vertices, tets } = bar([3, 2, 2])
  const triangles = boundaryTriangles(Uint32Array.from(tets.flat()), vertices.length)
  // Each half has 2 (3·2 + 3·2 + 2·2) cell faces of two triangles.
  assert.equal(triangles.length / 3, 2 * 2 * 2 * (6 + 6 + 4))
  const edges = new Set()
  let volume = 0
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = [...triangles.subarray(i, i + 3)].map((vertex) => vertices[vertex])
    volume += (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
      a[2] * (b[0] * c[1] - b[1] * c[0])) / 6
    for (let k = 0; k < 3; k++) edges.add(`${triangles[i + k]},${triangles[i + ((k + 1) % 3)]}`)
  }
  assert.ok(Math.abs(volume - 0.15 * 0.05 * 0.05) < 1e-12, `${volume}`)
  for (const edge of edges) assert.ok(edges.has(edge.split(',').reverse().join(',')), edge)
  const pairs = coincidentPairs(vertices.flat(), Uint32Array.from(triangles))
  assert.ok(pairs.length > 0)
})
