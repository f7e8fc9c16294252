/**
 * Sessions over Zenoh through a real bridge, `npm run test:bridge`. It needs what the other tests do not:
 *
 *     cargo install zenoh-bridge-remote-api       (SUTURA_ZENOH_BRIDGE names it, if it is not on the path)
 *     npm install --no-save @eclipse-zenoh/zenoh-ts
 */

import { spawn } from 'node:child_process'
import { createServer } from 'node:net'
import { setTimeout as sleep } from 'node:timers/promises'
import { Client } from '../build/index.js'
import { startDaemon } from '../scripts/daemon.mjs'
import { editsAndArrays, statesAndGenerations } from './bus.mjs'
import { config } from './bodies.mjs'

const { Config, open } = await import('@eclipse-zenoh/zenoh-ts')

const server = createServer().listen(0, '127.0.0.1')
await new Promise((resolve) => server.once('listening', resolve))
const { port } = server.address()
server.close()

const daemon = await startDaemon()
const program = process.env.SUTURA_ZENOH_BRIDGE ?? 'zenoh-bridge-remote-api'
const flags = ['-m', 'client', '-e', daemon.zenoh, '--no-multicast-scouting', '--ws-port', `127.0.0.1:${port}`]
const bridge = spawn(program, flags, { stdio: ['ignore', 'ignore', 'ignore'] })
bridge.once('error', (error) => {
  console.error(`${program} cannot be run: ${error.message}`)
  process.exit(1)
})

try {
  let zenohSession
  for (let tries = 0; zenohSession === undefined; tries++) {
    try {
      zenohSession = await open(new Config(`ws/127.0.0.1:${port}`))
    } catch (error) {
      if (tries > 50) throw error
      await sleep(200)
    }
  }
  const session = await new Client(daemon.address).create(config())
  await session.waitReady()
  await editsAndArrays(zenohSession, session)
  await statesAndGenerations(zenohSession, session)
  await zenohSession.close()
  console.log('edits, arrays, states and generations came through the bridge')
} finally {
  bridge.kill()
  await daemon.stop()
}
process.exit(0)
