/**
 * How long frames of a body take: node frames.mjs MESH DESCRIPTION [SECONDS], with the daemon built. The body is
 * stitched, simulated under gravity, and measured while it moves. Printed as JSON, in ms, medians and 99th percentiles:
 *
 * - `interval_ms`: from frame to frame as the browser shows them. Without a graphics card that is the time of a software
 *   rasterizer, and says little of a screen's.
 * - `script_ms`: what the viewer's own code takes in a frame, drawing commands included but not their execution.
 * - `main_thread_ms`: everything the page's thread does in the time of a frame, messages and layout included.
 */

import { openAsBlob, readFileSync } from 'node:fs'
import { basename } from 'node:path'
import { Client } from '../../clients/web/build/index.js'
import { startDaemon } from '../../clients/web/scripts/daemon.mjs'
import { openPage } from './browser.mjs'

const [mesh, description, seconds = '20'] = process.argv.slice(2)
if (!description) {
  console.error('usage: node --experimental-websocket frames.mjs MESH DESCRIPTION [SECONDS]')
  process.exit(2)
}

/** Where the description names no material. */
const SOFT = { law: 'stvk', young_modulus_pa: 1e5, poisson_ratio: 0.4, density_kg_m3: 1000 }

/** Notes when each frame begins, and how long its callbacks take. */
function watchFrames() {
  const ask = window.requestAnimationFrame.bind(window)
  window.frames_ = []
  window.requestAnimationFrame = (callback) =>
    ask((now) => {
      const begun = performance.now()
      callback(now)
      window.frames_.push([now, performance.now() - begun])
    })
}

const quantiles = (values) => {
  const sorted = [...values].sort((a, b) => a - b)
  const at = (part) => Number(sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))].toFixed(3))
  return { p50: at(0.5), p99: at(0.99) }
}

const daemon = await startDaemon()
let browser
try {
  const described = JSON.parse(readFileSync(description, 'utf8'))
  const { domain_materials = {}, fixed_vertices, stitches } = described
  const material = described.material ?? SOFT
  const client = new Client(daemon.address)
  const file = { name: basename(mesh), content: await openAsBlob(mesh) }
  const session = await client.create({ material, domain_materials, fixed_vertices }, file)
  await session.waitReady()
  await session.edit({ edits: [{ stitch: { pairs: stitches, stiffness_n_m: 1e5 } }] })
  await session.simulate({ dt_s: 0.01, publish_hz: 60, gravity_m_s2: [0, -9.81, 0] })

  browser = await openPage('about:blank')
  const { page, faults } = browser
  await page.addInitScript(watchFrames)
  await page.goto(`${daemon.address}/#/sessions/${session.id}`)
  await page.locator('#time').filter({ hasText: /[0-9]/ }).waitFor()
  await page.waitForTimeout(3000)
  const cdp = await page.context().newCDPSession(page)
  await cdp.send('Performance.enable')
  const busy = async () => {
    const { metrics } = await cdp.send('Performance.getMetrics')
    return metrics.find(({ name }) => name === 'TaskDuration').value
  }
  await page.evaluate(() => (window.frames_.length = 0))
  const before = await busy()
  await page.waitForTimeout(1000 * Number(seconds))
  const [after, frames] = [await busy(), await page.evaluate(() => window.frames_)]
  const intervals = frames.slice(1).map(([now], i) => now - frames[i][0])
  const info = await session.info()
  console.log(
    JSON.stringify({
      mesh: basename(mesh),
      n_vertices: info.n_vertices,
      n_tets: info.n_tets,
      basis_size: info.basis_size,
      n_frames: frames.length,
      interval_ms: quantiles(intervals),
      script_ms: quantiles(frames.map(([, taken]) => taken)),
      main_thread_ms: Number(((1000 * (after - before)) / frames.length).toFixed(3)),
      faults,
    }),
  )
} finally {
  await browser?.close()
  await daemon.stop()
}
