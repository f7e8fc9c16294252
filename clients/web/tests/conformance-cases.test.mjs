/** The cases that every client is held to: tests/data/conformance. */

import assert from 'node:assert/strict'
import { mkdirSync, readFileSync, writeFileSync } from 'node:fs'
import { join } from 'node:path'
import { after, before, test } from 'node:test'
import { Client, ProblemError } from '../build/index.js'
import { startDaemon } from '../scripts/daemon.mjs'
import { bytesOf, until } from './bodies.mjs'

const read = (name) =>
  JSON.parse(readFileSync(new URL(`../../../tests/data/conformance/${name}`, import.meta.url), 'utf8'))
/** What was received: its name, and its numbers as little-endian bytes. */
const entry = (name, ...values) => Buffer.concat([Buffer.from(`${name}\n`), ...values.map(bytesOf), Buffer.from('\n')])
const doubles = (values) => Float64Array.from(values.flat())

let daemon
let client
before(async () => {
  daemon = await startDaemon()
  client = new Client(daemon.address)
})
after(() => daemon?.stop())

function assertHas(found, expected, place) {
  for (const [name, value] of Object.entries(expected)) {
    if (value !== null && typeof value === 'object' && !Array.isArray(value)) assertHas(found[name], value, place)
    else assert.deepEqual(found[name], value, `${place}: ${name}`)
  }
}

/** Takes a step; what was received. */
async function take(session, step, place) {
  if (step.info) {
    assertHas(await session.info(), step.info, place)
  } else if (step.prepared) {
    await until(async () => (await session.info()).n_prepared_pairs >= step.prepared, 'the seams are prepared')
  } else if (step.reply) {
    const reply = await session.edit(step.edit)
    assertHas(reply, step.reply, place)
    return entry('frequencies', doubles(reply.frequencies_hz))
  } else if (step.problem) {
    await assert.rejects(session.edit(step.edit), (error) => {
      assert.ok(error instanceof ProblemError, `${place}: ${error}`)
      const { status, type, instance_pointer = null } = error.problem
      assert.deepEqual({ status, type, instance_pointer }, step.problem, place)
      return true
    })
  } else if (step.array) {
    const { array: name, generation, dtype, from } = step
    const given = from === undefined ? [generation] : [generation, from]
    // Whole numbers and frequencies come as they are, of one type.
    const bare = { tets: ['tets', 4], frequencies_hz: ['frequencies', 0] }[name]
    const array = bare ? await session[bare[0]](generation) : await session[name](...given, { dtype })
    const data = bare ? array : array.data
    const shape = bare ? (bare[1] ? [data.length / bare[1], bare[1]] : [data.length]) : array.shape
    const kinds = { u32: Uint32Array, f32: Float32Array, f64: Float64Array }
    assert.equal(data.constructor, kinds[dtype], place)
    const file = await client.bytes(`/v1/sessions/${session.id}/generations/${generation}/${name}`, {
      accept: 'application/x-npy',
      query: name === 'tets' ? {} : { dtype, from },
    })
    assert.ok(bytesOf(data).equals(Buffer.from(file).subarray(-data.byteLength)), place)
    return entry(`${name} [${shape.join(', ')}]`, data)
  } else if (step.ids) {
    const stitches = await session.stitches(step.stitches)
    assert.deepEqual([stitches.ids, [...stitches.pairs]], [step.ids, step.pairs.flat()], place)
  } else if (step.q) {
    const { energy_j, force, stiffness } = await session.evaluate(step.q, { generation: step.evaluate })
    return entry('evaluation', ...[[energy_j], force, stiffness].map(doubles))
  } else {
    assert.fail(`${place}: no such step`)
  }
  return Buffer.alloc(0)
}

test('the cases of every client', async () => {
  const mesh = read('bar.json')
  const received = []
  for (const [number, { name, config, steps }] of read('cases.json').entries()) {
    const session = await client.create({ ...config, mesh })
    await session.waitReady()
    for (const [at, step] of steps.entries()) {
      received.push(Buffer.from(`${number}.${at} `), await take(session, step, `${name}, step ${at}`))
    }
    await session.delete()
  }
  const everything = Buffer.concat(received)
  assert.ok(everything.length > 1_000_000)
  const folder = process.env.SUTURA_CONFORMANCE
  if (folder) {
    mkdirSync(folder, { recursive: true })
    writeFileSync(join(folder, 'typescript'), everything)
  }
})
