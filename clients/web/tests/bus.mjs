/** What a session over Zenoh is held to, whatever carries its queries. */

import assert from 'node:assert/strict'
import { BusClient, ProblemError, Tracker } from '../build/index.js'
import { R, seam, stitch } from './bodies.mjs'

const bytesOf = (data) => Buffer.from(data.buffer, data.byteOffset, data.byteLength)

/** Edits, arrays and refusals of `session` (of the bar, over HTTP) through `zenohSession`. */
export async function editsAndArrays(zenohSession, session) {
  const bus = new BusClient(zenohSession).session(session.id)
  assert.deepEqual(await bus.info(), await session.info())
  const reply = await bus.edit(stitch(seam().slice(0, 5)))
  assert.deepEqual([reply.generation, reply.n_stitches], [1, 5])
  assert.deepEqual(reply.frequencies_hz, (await session.info()).frequencies_hz)
  for (const [name, dtype] of [['basis', 'f64'], ['basis', 'f32'], ['modes', 'f64'], ['mass', 'f64']]) {
    const [over, expected] = await Promise.all([bus, session].map((from) => from[name](1, { dtype })))
    assert.deepEqual([over.shape, over.generation], [expected.shape, 1])
    assert.ok(bytesOf(over.data).equals(bytesOf(expected.data)), `${name} ${dtype}`)
  }
  assert.deepEqual(await bus.stitches(), await session.stitches())
  const transfer = await bus.transfer(1, 0, { dtype: 'f64' })
  assert.deepEqual(transfer, await session.transfer(1, 0, { dtype: 'f64' }))
  await assert.rejects(bus.edit(stitch([[0, 1]])), (error) => {
    assert.ok(error instanceof ProblemError, String(error))
    assert.deepEqual([error.status, error.problem.instance_pointer], [422, '/edits/0/stitch/pairs/0'])
    return true
  })
  const nobody = new BusClient(zenohSession).session('nobody')
  await assert.rejects(nobody.info(), (error) => error instanceof ProblemError && error.status === 404)
  const tracker = await Tracker.open(bus)
  assert.equal(tracker.shapes.size, R)
}

/** States and generations of `session` as `zenohSession` publishes them. */
export async function statesAndGenerations(zenohSession, session) {
  const bus = new BusClient(zenohSession).session(session.id)
  await session.edit({ restore: 0, edits: [] })
  await session.edit(stitch(seam()))
  const [states, generations] = await Promise.all([bus.states(), bus.generations()])
  await session.simulate({ dt_s: 0.005, publish_hz: 100, gravity_m_s2: [0, -9.81, 0] })
  const tracker = await Tracker.open(bus)
  for await (const state of states) {
    const u = await tracker.displacement(state)
    if (state.timeSeconds > 0.2) {
      assert.ok(u.some((x) => Math.abs(x) > 1e-4), 'the bar sags')
      break
    }
  }
  const unstitched = await bus.edit({ edits: [{ unstitch: { stitch_ids: [(await bus.stitches()).ids[0]] } }] })
  for await (const made of generations) {
    assert.ok(made.generation <= unstitched.generation)
    if (made.generation === unstitched.generation) break
  }
}
