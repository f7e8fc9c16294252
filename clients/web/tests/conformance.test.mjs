/** The client against a real daemon: what the Rust client is held to, and the same bytes. */

import assert from 'node:assert/strict'
import { execFile } from 'node:child_process'
import { readFileSync } from 'node:fs'
import { after, before, test } from 'node:test'
import { fileURLToPath } from 'node:url'
import { promisify } from 'node:util'
import { Client, ProblemError, Tracker, combine, decodeNpy } from '../build/index.js'
import { startDaemon } from '../scripts/daemon.mjs'
import { committedSchema, schemaOf } from '../scripts/schema.mjs'
import { R, STIFFNESS, TIP, bar, bytesOf, config, seam, stitch, until } from './bodies.mjs'

let daemon
let client

before(async () => {
  daemon = await startDaemon()
  client = new Client(daemon.address)
})

after(() => daemon?.stop())

async function readyBar(changes = {}) {
  const session = await client.create({ ...config(), ...changes })
  await session.waitReady()
  return session
}

/** A bar whose seam is prepared. */
async function preparedBar() {
  const session = await readyBar({ seams: seam() })
  await until(async () => (await session.info()).n_prepared_pairs === seam().length, 'the seam is prepared')
  return session
}

test('the types are those of the daemon', async () => {
  const current = await schemaOf(daemon.address)
  assert.ok(committedSchema() === current, 'client/schema.ts is not current: run `npm run schema`')
})

test('a build tells of its stages and ends ready', async () => {
  const session = await client.create(config())
  const stages = new Set()
  const info = await session.waitReady((event) => event.event === 'stage' && stages.add(event.stage))
  assert.equal(info.state, 'ready')
  assert.deepEqual([info.n_vertices, info.n_tets, info.basis_size], [90, 192, R])
  assert.ok(stages.size > 0)
  const listed = await client.listAll()
  assert.ok(listed.some(({ id }) => id === session.id))
  const fork = await session.fork('twin')
  assert.deepEqual((await fork.info()).frequencies_hz, info.frequencies_hz)
  await fork.delete()
  await assert.rejects(fork.info(), (error) => error instanceof ProblemError && error.status === 404)
})

test('a key goes along with streams, which take no header', () => {
  const asked = []
  class WebSocket {
    constructor(url) {
      asked.push(url)
    }
    addEventListener() {}
    close() {}
  }
  new Client('http://daemon:1/', { key: 'k-1', WebSocket }).session('a').states()
  new Client('https://daemon', { WebSocket }).session('a').states()
  const path = '/v1/sessions/a/stream'
  assert.deepEqual(asked, [`ws://daemon:1${path}?access_token=k-1`, `wss://daemon${path}`])
})

test('a mesh of two files is read', async () => {
  const files = ['two_boxes.node', 'two_boxes.ele'].map((name) => ({
    name,
    content: new Blob([readFileSync(new URL(`../../../tests/data/formats/${name}`, import.meta.url))]),
  }))
  const { mesh: _, fixed_vertices: __, ...rest } = config()
  const session = await client.create(rest, ...files)
  const info = await session.waitReady()
  assert.ok(info.n_tets > 0)
  assert.equal((await session.tets()).length, 4 * info.n_tets)
  await session.delete()
})

test('arrays are bit for bit those of the .npy files', async () => {
  const session = await readyBar()
  await session.edit(stitch(seam()))
  for (const [name, shape] of [
    ['modes', [8, 90, 3]],
    ['basis', [R, 90, 3]],
    ['positions', [90, 3]],
    ['mass', [90]],
  ]) {
    for (const dtype of ['f32', 'f64']) {
      const array = await session[name](1, { dtype })
      const path = `/v1/sessions/${session.id}/generations/1/${name}?dtype=${dtype}`
      const file = await client.bytes(path, { accept: 'application/x-npy' })
      const npy = decodeNpy(file)
      assert.deepEqual([array.shape, npy.shape], [shape, shape], name)
      assert.equal(array.data.constructor, dtype === 'f64' ? Float64Array : Float32Array)
      assert.ok(bytesOf(array.data).equals(bytesOf(npy.data)), `${name} ${dtype}`)
      assert.ok(bytesOf(array.data).equals(Buffer.from(file).subarray(-array.data.byteLength)))
      assert.equal(array.generation, 1)
    }
  }
  const tets = await session.tets()
  assert.deepEqual([...tets], bar().tets.flat())
  const file = await client.bytes(`/v1/sessions/${session.id}/generations/1/tets`, {
    accept: 'application/x-npy',
  })
  assert.ok(bytesOf(tets).equals(bytesOf(decodeNpy(file).data)))
  const positions = await session.positions(1, { dtype: 'f64' })
  assert.deepEqual([...positions.data], bar().vertices.flat())
})

test('bases are orthonormal, and transfer and delta lead from one to the next', async () => {
  const session = await readyBar()
  await session.edit(stitch(seam().slice(0, 5)))
  await session.edit(stitch(seam().slice(5)))
  const { data: mass } = await session.mass('current', { dtype: 'f64' })
  const product = (u, v) => u.reduce((sum, x, i) => sum + x * v[i] * mass[Math.floor(i / 3)], 0)
  const column = (basis, i) => basis.data.subarray(270 * i, 270 * (i + 1))
  for (const [from, to] of [[0, 1], [1, 2], [2, 0]]) {
    const [old, now] = await Promise.all(
      [from, to].map((generation) => session.basis(generation, { dtype: 'f64' })),
    )
    const transfer = await session.transfer(to, from, { dtype: 'f64' })
    for (let i = 0; i < R; i++) {
      for (let j = 0; j < R; j++) {
        const expected = product(column(now, i), column(old, j))
        assert.ok(Math.abs(transfer.data[R * i + j] - expected) < 1e-8)
        const unit = product(column(now, i), column(now, j))
        assert.ok(Math.abs(unit - (i === j ? 1 : 0)) < 1e-8)
      }
    }
    const { columns, w } = await session.delta(to, from, { dtype: 'f64' })
    for (let j = 0; j < R; j++) {
      const sum = new Float64Array(270)
      for (let i = 0; i < w.shape[0]; i++) {
        const part = i < R ? column(old, i) : column(columns, i - R)
        part.forEach((x, k) => (sum[k] += w.data[R * i + j] * x))
      }
      sum.forEach((x, k) => assert.ok(Math.abs(x - column(now, j)[k]) < 1e-7))
    }
  }
})

test('edits name their stitches, and can be undone', async () => {
  const session = await readyBar()
  const open = (await session.info()).frequencies_hz
  const reply = await session.edit({ base_generation: 0, ...stitch(seam()) })
  assert.deepEqual([reply.generation, reply.n_stitches], [1, seam().length])
  assert.ok(reply.certificate.lower_eigenvalue_error >= 0)
  const stitches = await session.stitches()
  assert.deepEqual(stitches.ids, reply.stitch_ids)
  assert.deepEqual([...stitches.pairs], seam().flat())
  assert.ok(stitches.stiffness.every((k) => k === STIFFNESS))
  const restored = await session.edit({ restore: 0, edits: [] })
  assert.deepEqual([restored.generation, restored.frequencies_hz], [2, open])
  assert.deepEqual((await session.stitches()).ids, [])
})

test('problems are typed and point at the input at fault', async () => {
  const session = await readyBar()
  const refusal = (status, pointer) => (error) => {
    assert.ok(error instanceof ProblemError, String(error))
    assert.equal(error.status, status)
    assert.equal(error.problem.instance_pointer, pointer)
    assert.match(error.problem.type, /^urn:sutura:problem:/)
    return true
  }
  await assert.rejects(session.edit(stitch([[0, 1]])), refusal(422, '/edits/0/stitch/pairs/0'))
  const stale = { ...stitch(seam()), base_generation: 5 }
  await assert.rejects(session.edit(stale), (error) => error.status === 409)
  await assert.rejects(client.session('nobody').info(), (error) => error.status === 404)
  await assert.rejects(client.create({ mesh: bar() }), refusal(422, '/material'))
  await assert.rejects(session.simulation(), (error) => error.status === 404)
})

test('an edit can be aborted', async () => {
  const session = await readyBar()
  const stop = new AbortController()
  const edit = session.edit(stitch(seam()), stop.signal)
  stop.abort()
  await assert.rejects(edit, { name: 'AbortError' })
})

test('the evaluator has what the daemon evaluates with', async () => {
  for (const smoothing of [false, true]) {
    const session = await readyBar({ cubature: { ...config().cubature, smoothing } })
    await session.edit(stitch(seam()))
    const tables = await session.evaluator('current', { dtype: 'f64' })
    assert.equal(tables.size, R)
    assert.equal(tables.basisRows.length, tables.tets.length * 12 * R)
    const basis = await session.basis(1, { dtype: 'f64' })
    const tets = await session.tets()
    tables.tets.forEach((tet, point) => {
      for (let axis = 0; axis < 3; axis++) {
        for (let j = 0; j < R; j++) {
          const gaps = [0, 1, 2, 3].map((corner) => {
            const row = tables.basisRows[((4 * point + corner) * 3 + axis) * R + j]
            return row - basis.data[(j * 90 + tets[4 * tet + corner]) * 3 + axis]
          })
          // A smoothed point has another gradient, but the mean of the corners.
          const sum = gaps.reduce((all, gap) => all + gap)
          assert.ok(smoothing ? Math.abs(sum) < 1e-11 : gaps.every((gap) => Math.abs(gap) < 1e-12))
        }
      }
    })
    const { energy_j, force, stiffness } = await session.evaluate(new Array(R).fill(0))
    assert.equal(energy_j, 0)
    assert.ok(force.every((f) => Math.abs(f) < 1e-9) && stiffness.length === R)
  }
})

test('a tracker follows generations, in a prepared seam by W alone', async () => {
  const session = await preparedBar()
  const asked = []
  const watched = Object.create(session, {
    basis: { value: (...given) => (asked.push('basis'), session.basis(...given)) },
    block: { value: (...given) => (asked.push('block'), session.block(...given)) },
    combination: { value: (...given) => (asked.push('combination'), session.combination(...given)) },
  })
  const tracker = await Tracker.open(watched)
  assert.equal(await tracker.prefetch(), true)
  asked.length = 0
  await session.edit(stitch(seam().slice(0, 5)))
  await tracker.follow(1)
  assert.deepEqual([tracker.generation, asked], [1, ['combination']])

  const vertices = Uint32Array.of(TIP, 0, 7)
  const some = await Tracker.open(session, { vertices })
  const whole = await Tracker.open(session, { maxBytes: 0 })
  assert.equal(whole.dictionaryBytes, 0)
  const { data: basis } = await session.basis(1, { dtype: 'f64' })
  const q = Float64Array.from({ length: R }, (_, i) => 0.01 * Math.sin(i + 1))
  const expected = new Float64Array(270)
  q.forEach((x, j) => expected.forEach((_, k) => (expected[k] += x * basis[270 * j + k])))
  const size = Math.max(...expected.map(Math.abs))
  for (const displacement of [tracker.reconstruct(q), whole.reconstruct(q)]) {
    displacement.forEach((x, k) => assert.ok(Math.abs(x - expected[k]) < 2e-5 * size, `${k}`))
  }
  some.reconstruct(q).forEach((x, k) => {
    assert.ok(Math.abs(x - expected[3 * vertices[Math.floor(k / 3)] + (k % 3)]) < 2e-5 * size)
  })
  assert.throws(() => tracker.reconstruct([1, 2]), /2 coordinates for a basis of 20/)
  const { columns, coefficients } = tracker.shapes
  assert.deepEqual(combine(columns, coefficients(q)), tracker.reconstruct(q))
})

test('states arrive, answer to forces and cross an edit without a jump', async () => {
  const session = await readyBar()
  await session.edit(stitch(seam().slice(0, 8)))
  await session.simulate({ dt_s: 0.002, publish_hz: 500, gravity_m_s2: [0, -9.81, 0] })
  await session.pushForces([{ vertex: TIP, force_n: [0, 0, 0.01], duration_s: 3600 }])
  const tracker = await Tracker.open(session)
  const states = session.states()
  let before
  let jump
  let editing
  for await (const state of states) {
    const u = await tracker.displacement(state)
    assert.ok(state.timeSeconds < 60, 'neither moves nor crosses')
    if (!editing && state.timeSeconds > 0.3 && u[3 * TIP + 2] > 1e-5) {
      assert.ok(u[3 * TIP + 1] < -1e-4, 'the tip sags')
      editing = session.edit(stitch(seam().slice(8)))
    }
    if (before && before.state.generation < state.generation) {
      // The moment of the switch is published in both generations, but either may be lost on the way.
      if (before.state.timeSeconds === state.timeSeconds) {
        const norm = (v) => Math.hypot(...v)
        jump = norm(u.map((x, k) => x - before.u[k])) / norm(before.u)
      }
      break
    }
    before = { state, u }
  }
  assert.equal((await editing).generation, 2)
  assert.ok(jump === undefined || jump < 0.01, `${jump}`)
  assert.ok((await session.simulation()).n_forces >= 1)
  const hold = { id: 2 ** 50 + 1, vertex: TIP, target_m: [0.2, 0.1, 0], stiffness_n_m: 1 }
  await session.grab([hold])
  await until(async () => (await session.simulation()).n_grabs === 1, 'it is held')
  await session.grab([], [hold.id])
  await until(async () => (await session.simulation()).n_grabs === 0, 'it is let go')
  await session.stopSimulation()
  await session.delete()
})

test('the example of the documentation runs', async () => {
  const data = fileURLToPath(new URL('../../../tests/data/stomach_small', import.meta.url))
  const example = fileURLToPath(new URL('../examples/stitch.mjs', import.meta.url))
  const files = [daemon.address, `${data}.msh`, `${data}.json`]
  const flags = ['--experimental-websocket', '--no-warnings', example, ...files]
  const { stdout } = await promisify(execFile)(process.execPath, flags)
  assert.match(stdout, /before: \[ 1\.39.*after:  \[ 1\.41/s)
  assert.match(stdout, /Float32Array\(3\)/)
  const shown = readFileSync(new URL('../README.md', import.meta.url), 'utf8')
  assert.ok(shown.includes(readFileSync(example, 'utf8').trimEnd()))
})

test('a stream ends with its session', async () => {
  const session = await readyBar()
  await session.edit(stitch(seam()))
  await session.simulate({})
  const states = session.states()
  const events = session.events()
  await events.next()
  let n = 0
  for await (const state of states) {
    assert.equal(state.generation, 1)
    if (n++ === 0) await session.delete()
  }
  const heard = []
  for await (const event of events) heard.push(event.event)
  assert.equal(heard.at(-1), 'deleted')
})
