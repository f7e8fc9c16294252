/**
 * Sessions over Zenoh, without Zenoh: a stand-in carries the queries to a real daemon over HTTP. What a real
 * bridge makes of them is tests/bridge.mjs, which needs one.
 */

import assert from 'node:assert/strict'
import { after, before, test } from 'node:test'
import { BusStream, Client } from '../build/index.js'
import { startDaemon } from '../scripts/daemon.mjs'
import { editsAndArrays } from './bus.mjs'
import { config } from './bodies.mjs'

let daemon
before(async () => {
  daemon = await startDaemon()
})
after(() => daemon?.stop())

const FRAME = 'application/vnd.sutura.frame'

/** A session of zenoh-ts whose every query is one over HTTP. */
function standIn(address) {
  return {
    asked: [],
    async get(selector, options) {
      this.asked.push([selector, options])
      const [key, parameters = ''] = selector.split('?')
      const [, id, resource] = key.match(/^sutura\/v1\/sessions\/([^/]+)\/(\w+)$/)
      const given = new Map(parameters.split(';').map((pair) => pair.split('=')))
      const path = { info: '', edits: '/edits', seams: '/seams' }[resource]
      const generation = given.get('generation')
      given.delete('generation')
      const query = new URLSearchParams([...given].filter(([name]) => name))
      const url =
        path === undefined
          ? `${address}/v1/sessions/${id}/generations/${generation}/${resource}?${query}`
          : `${address}/v1/sessions/${id}${path}`
      const answer = await fetch(url, {
        method: options.payload ? 'POST' : 'GET',
        headers: { accept: FRAME, 'content-type': options.encoding ?? '' },
        body: options.payload ?? null,
      })
      const bytes = new Uint8Array(await answer.arrayBuffer())
      const payload = () => ({ toBytes: () => bytes })
      const result = answer.ok ? { keyexpr: () => key, payload } : { payload }
      return (async function* () {
        yield { result: () => result }
      })()
    },
  }
}

test('edits and arrays over Zenoh are those over HTTP', async () => {
  const session = await new Client(daemon.address).create(config())
  await session.waitReady()
  const zenohSession = standIn(daemon.address)
  await editsAndArrays(zenohSession, session)
  const [selector, options] = zenohSession.asked.find(([key]) => key.endsWith('/edits'))
  assert.equal(selector, `sutura/v1/sessions/${session.id}/edits`)
  assert.equal(options.encoding, 'application/json')
  assert.ok(options.timeout.value >= 60_000, 'an edit from scratch takes its time')
  await session.delete()
})

test('a daemon that is not there is told from one that refuses', async () => {
  const nobody = { get: async () => (async function* () {})() }
  const { BusClient } = await import('../build/index.js')
  await assert.rejects(new BusClient(nobody).session('a').info(), /nobody answers for sutura\/v1\/sessions\/a\/info/)
})

test('keys go along, a tenant hears its own, and a stream that is closed ends', async () => {
  const { BusClient } = await import('../build/index.js')
  const put = []
  let publish
  let ended = 0
  const zenohSession = {
    put: async (...given) => put.push(given),
    // Whose session it is decides where it is published.
    get: async (selector, { attachment }) => {
      assert.deepEqual([selector, attachment], ['sutura/v1/sessions/a/info', 'k-1'])
      const toBytes = () => new TextEncoder().encode(JSON.stringify({ tenant: 'clinic' }))
      const result = { keyexpr: () => selector, payload: () => ({ toBytes }) }
      return (async function* () {
        yield { result: () => result }
      })()
    },
    declareSubscriber: async (key, { handler }) => {
      assert.equal(key, 'sutura/v1/tenants/clinic/sessions/a/generation')
      publish = (text) => handler({ payload: () => ({ toBytes: () => new TextEncoder().encode(text) }) })
      return { undeclare: async () => void (ended += 1) }
    },
  }
  const session = new BusClient(zenohSession, { key: 'k-1' }).session('a')
  await session.pushForces([{ vertex: 1, force_n: [0, 1, 0], duration_s: 1 }])
  const [key, payload, options] = put[0]
  assert.equal(key, 'sutura/v1/sessions/a/forces')
  assert.deepEqual(JSON.parse(payload).forces[0].force_n, [0, 1, 0])
  assert.deepEqual([options.attachment, options.congestionControl, options.express], ['k-1', 0, true])

  const generations = await session.generations()
  assert.ok(generations instanceof BusStream)
  for (let n = 1; n <= 70; n++) publish(JSON.stringify({ generation: n }))
  assert.equal(generations.nDropped, 6)
  generations.close()
  const heard = []
  for await (const { generation } of generations) heard.push(generation)
  assert.deepEqual([heard[0], heard.length, ended], [7, 64, 1])

  const broken = await session.generations()
  publish('{')
  await assert.rejects(broken[Symbol.asyncIterator]().next(), SyntaxError)
})
