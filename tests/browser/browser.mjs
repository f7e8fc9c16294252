/** A real browser on a real daemon. */

import { mkdirSync, mkdtempSync, readFileSync, rmSync } from 'node:fs'
import { createRequire } from 'node:module'
import { tmpdir } from 'node:os'
import { join } from 'node:path'
import { fileURLToPath } from 'node:url'
import { inflateSync } from 'node:zlib'
import { chromium } from 'playwright-core'

const AXE = readFileSync(createRequire(import.meta.url).resolve('axe-core/axe.min.js'), 'utf8')

/** Screenshots are kept here. */
export const OUTPUT = fileURLToPath(new URL('output', import.meta.url))

const FLAGS = [
  '--no-sandbox',
  '--use-gl=angle',
  '--use-angle=swiftshader',
  '--enable-unsafe-swiftshader',
  '--disable-quic',
  '--no-first-run',
  '--disable-background-networking',
  '--disable-component-update',
  '--disable-sync',
]

/** Far longer than anything takes, on a busy machine and without a graphics card. */
const PATIENCE = 120_000

/** Opens the page at `address`; `faults` are what it logged as errors. */
export async function openPage(address, options = {}) {
  mkdirSync(OUTPUT, { recursive: true })
  const profile = mkdtempSync(join(tmpdir(), 'sutura-browser-'))
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: process.env.CHROMIUM ?? '/usr/bin/chromium',
    headless: true,
    args: FLAGS,
    viewport: { width: 1366, height: 768 },
    ...options,
  })
  const page = context.pages()[0] ?? (await context.newPage())
  page.setDefaultTimeout(PATIENCE)
  const faults = []
  page.on('console', (message) => {
    if (['error', 'warning'].includes(message.type())) faults.push(message.text())
  })
  page.on('pageerror', (error) => faults.push(String(error.stack)))
  page.on('requestfailed', (request) => {
    // Those that the page gives up itself, such as the events of a session it leaves.
    if (request.failure()?.errorText !== 'net::ERR_ABORTED') faults.push(`failed: ${request.url()}`)
  })
  await page.goto(address)
  return {
    page,
    faults,
    async close() {
      await context.close()
      rmSync(profile, { recursive: true, force: true })
    },
  }
}

/** What assistive technology would stumble over, by the rules of WCAG 2.2 AA. */
export async function obstacles(page) {
  await page.evaluate(AXE)
  const { violations } = await page.evaluate(() => window.axe.run())
  return violations.flatMap(({ id, help, nodes }) =>
    nodes.map((node) => `${id}: ${help}: ${node.html.slice(0, 200)}: ${node.failureSummary}`),
  )
}

/** The canvas as it is seen: kept as a picture, and its pixels (width, height, RGB). */
export async function picture(page, name) {
  // What lies over the canvas would count as drawn.
  const shown = await page.locator('#stage').boundingBox()
  const path = join(OUTPUT, `${name}.png`)
  await page.screenshot({ path })
  const margin = { x: shown.x + 60, y: shown.y + 70 }
  const clip = { ...margin, width: shown.width - 120, height: shown.height - 140 }
  return decodePng(await page.screenshot({ clip }))
}

/** Part of the pixels in which two pictures differ. */
export function difference(a, b) {
  if (a.data.length !== b.data.length) return 1
  let n = 0
  for (let i = 0; i < a.data.length; i += a.channels) {
    const gap = [0, 1, 2].map((k) => Math.abs(a.data[i + k] - b.data[i + k]))
    if (Math.max(...gap) > 16) n += 1
  }
  return n / (a.width * a.height)
}

/** Part of the pixels that are not near the colour of the corner: what is drawn. */
export function drawn(image) {
  const { data, channels, width, height } = image
  let n = 0
  for (let i = 0; i < data.length; i += channels) {
    const gap = [0, 1, 2].map((k) => Math.abs(data[i + k] - data[k]))
    if (Math.max(...gap) > 40) n += 1
  }
  return n / (width * height)
}

/** Reads the PNG files that the browser makes: 8 bits, RGB or RGBA, not interlaced. */
function decodePng(bytes) {
  const width = bytes.readUInt32BE(16)
  const height = bytes.readUInt32BE(20)
  const [depth, type, , , interlaced] = bytes.subarray(24, 29)
  const channels = { 2: 3, 6: 4 }[type]
  if (depth !== 8 || channels === undefined || interlaced) throw new Error('an unexpected picture')
  const parts = []
  for (let at = 8; at < bytes.length; ) {
    const length = bytes.readUInt32BE(at)
    if (bytes.toString('latin1', at + 4, at + 8) === 'IDAT') {
      parts.push(bytes.subarray(at + 8, at + 8 + length))
    }
    at += 12 + length
  }
  const raw = inflateSync(Buffer.concat(parts))
  const stride = width * channels
  const data = new Uint8Array(stride * height)
  for (let y = 0; y < height; y++) {
    const filter = raw[y * (stride + 1)]
    for (let x = 0; x < stride; x++) {
      const left = x >= channels ? data[y * stride + x - channels] : 0
      const up = y > 0 ? data[(y - 1) * stride + x] : 0
      const upLeft = x >= channels && y > 0 ? data[(y - 1) * stride + x - channels] : 0
      const guess = [0, left, up, (left + up) >> 1, paeth(left, up, upLeft)][filter]
      data[y * stride + x] = raw[y * (stride + 1) + 1 + x] + guess
    }
  }
  return { width, height, channels, data }
}

function paeth(left, up, upLeft) {
  const guess = left + up - upLeft
  const gaps = [left, up, upLeft].map((value) => Math.abs(guess - value))
  if (gaps[0] <= gaps[1] && gaps[0] <= gaps[2]) return left
  return gaps[1] <= gaps[2] ? up : upLeft
}
