/** A real daemon for one test or script: its own process, free ports, a scratch folder. */

import { spawn } from 'node:child_process'
import { mkdtempSync, rmSync } from 'node:fs'
import { tmpdir } from 'node:os'
import { join } from 'node:path'
import { createInterface } from 'node:readline'
import { fileURLToPath } from 'node:url'

const ROOT = fileURLToPath(new URL('../../..', import.meta.url))
const TARGET = process.env.CARGO_TARGET_DIR ?? join(ROOT, 'target')

/** The executable: that of `SUTURA_EXECUTABLE`, else the debug build. */
export const EXECUTABLE = process.env.SUTURA_EXECUTABLE ?? join(TARGET, 'debug', 'sutura')

/** Starts a daemon and waits until it has said where it listens. */
export async function startDaemon() {
  const scratch = mkdtempSync(join(tmpdir(), 'sutura-'))
  const flags = ['serve', '--http', '127.0.0.1:0', '--zenoh', 'tcp/127.0.0.1:0', '--log', 'warn']
  const stdio = ['ignore', 'pipe', 'inherit']
  const child = spawn(EXECUTABLE, flags, { cwd: scratch, stdio })
  const ended = new Promise((resolve) => child.once('exit', resolve))
  const served = {}
  await new Promise((resolve, reject) => {
    child.once('error', (error) => reject(new Error(`${EXECUTABLE} cannot be run: ${error.message}`)))
    child.once('exit', (code) => reject(new Error(`the daemon ended with ${code}`)))
    createInterface(child.stdout).on('line', (line) => {
      const [name, address] = line.split(' ')
      if (address) served[name] = address.replace(/\/$/, '')
      if (served.http && served.zenoh) resolve()
    })
  })
  return {
    /** Such as `http://127.0.0.1:8080`. */
    address: served.http,
    /** Such as `tcp/127.0.0.1:7447`. */
    zenoh: served.zenoh,
    async stop() {
      child.kill('SIGKILL')
      await ended
      rmSync(scratch, { recursive: true, force: true })
    },
  }
}
