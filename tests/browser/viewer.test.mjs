/** The viewer in a browser: upload, stitch, pull, compare, undo. */

import assert from 'node:assert/strict'
import { mkdtempSync, rmSync, writeFileSync } from 'node:fs'
import { tmpdir } from 'node:os'
import { join } from 'node:path'
import { after, afterEach, before, test } from 'node:test'
import { fileURLToPath } from 'node:url'
import { startDaemon } from '../../clients/web/scripts/daemon.mjs'
import { bar } from '../../clients/web/tests/bodies.mjs'
import { OUTPUT, difference, drawn, obstacles, openPage, picture } from './browser.mjs'

const DATA = fileURLToPath(new URL('../data/', import.meta.url))

let daemon
let browser

before(async () => {
  daemon = await startDaemon()
})

afterEach(async () => {
  await browser?.close()
  browser = undefined
})

after(() => daemon?.stop())

async function open(options) {
  browser = await openPage(daemon.address, options)
  return browser
}

/** Uploads a mesh of the test data with its configuration, and waits until it is drawn. */
async function upload(page, name) {
  await page.locator('#new-session').click()
  await page.locator('#upload-files').setInputFiles([`${DATA}${name}.msh`, `${DATA}${name}.json`])
  await page.getByRole('button', { name: 'Open session' }).click()
  await page.locator('#generation', { hasText: 'generation 0' }).waitFor()
}

/** The frequencies now, as they are shown. */
const frequencies = (page) => page.locator('#modes .after').allTextContents()

const settled = (page, generation) =>
  page.locator('#generation', { hasText: new RegExp(`^generation ${generation}$`) }).waitFor()

test('a stomach is uploaded, stitched, pulled at, compared and opened again', async () => {
  const { page, faults } = await open()
  assert.equal(await page.title(), 'Sutura')
  await upload(page, 'stomach_small')
  const rest = await picture(page, 'rest')
  assert.ok(drawn(rest) > 0.05, `the canvas is empty: ${drawn(rest)}`)
  const opened = await frequencies(page)
  assert.equal(opened.length, 30)
  assert.ok(Math.abs(Number(opened[0]) - 1.391) < 2e-3, opened[0])

  // The whole incision in one go, and what the edit says of itself.
  await page.locator('#stitch-all').click()
  await settled(page, 1)
  const closed = await frequencies(page)
  assert.ok(Number(closed[0]) > Number(opened[0]), `${opened[0]} ${closed[0]}`)
  assert.deepEqual(await page.locator('#modes .before').allTextContents(), opened)
  assert.match(await page.locator('#edit-total').textContent(), /\d+ ms|\d s/)
  assert.match(await page.locator('#verdict').textContent(), /patched|refined|rebuilt/)
  assert.ok((await page.locator('#last-edit .bar span').count()) >= 2)
  assert.equal(await page.locator('#seam-summary').textContent(), '31 of 31 candidate pairs stitched.')
  const stitched = await picture(page, 'stitched')
  assert.ok(difference(rest, stitched) > 1e-4, 'the marks of the pairs have not changed')

  // A pull moves the body, which swings back afterwards.
  await page.keyboard.press('g')
  assert.equal(await page.locator('#tool-pull').getAttribute('aria-pressed'), 'true')
  const { x, y, width, height } = await page.locator('#stage').boundingBox()
  await page.mouse.move(x + width * 0.38, y + height * 0.45)
  await page.mouse.down()
  await page.mouse.move(x + width * 0.55, y + height * 0.35, { steps: 8 })
  await page.locator('#pull-force', { hasText: 'Pulling with' }).waitFor()
  await page.waitForFunction(() => Number.parseFloat(document.querySelector('#time').textContent) > 1.5)
  const pulled = await picture(page, 'pulled')
  assert.ok(difference(stitched, pulled) > 0.01, `${difference(stitched, pulled)}`)
  await page.mouse.up()
  const released = Number.parseFloat(await page.locator('#time').textContent())
  await page.waitForFunction(
    (from) => Number.parseFloat(document.querySelector('#time').textContent) > from + 1,
    released,
  )
  const swinging = await picture(page, 'released')
  assert.ok(difference(pulled, swinging) > 0.005, `${difference(pulled, swinging)}`)
  await page.locator('#simulate', { hasText: 'Stop' }).click()
  await page.locator('#simulate', { hasText: 'Start' }).waitFor()

  // The old basis beside the new one.
  await page.locator('#compare').selectOption('0')
  await page.locator('#captions', { hasText: 'times as far: the old one locks' }).waitFor()
  await picture(page, 'compared')
  await page.locator('#compare').selectOption('')
  await page.locator('#captions').waitFor({ state: 'hidden' })

  // A mode swings.
  await page.locator('#modes input').first().fill('1')
  await page.waitForTimeout(700)
  const swung = await picture(page, 'mode')
  assert.ok(difference(stitched, swung) > 0.005, `${difference(stitched, swung)}`)
  await page.getByRole('button', { name: 'All still' }).click()

  // Undo, redo.
  await page.keyboard.press('Control+z')
  await settled(page, 2)
  assert.deepEqual(await frequencies(page), opened)
  assert.match(await page.locator('#seam-summary').textContent(), /^0 of 31/)
  await page.locator('#redo').click()
  await settled(page, 3)
  assert.deepEqual(await frequencies(page), closed)

  // What was before outlives the page, and so does undo.
  await page.reload()
  await settled(page, 3)
  assert.deepEqual(await frequencies(page), closed)
  assert.deepEqual(await page.locator('#modes .before').allTextContents(), opened)
  await page.locator('#undo').click()
  await settled(page, 4)
  assert.deepEqual(await frequencies(page), opened)
  assert.deepEqual(faults, [])
})

test('pairs are stitched and opened with the brush', async () => {
  const { page, faults } = await open()
  await upload(page, 'stomach_small')
  await page.keyboard.press('s')
  // From the side on which the incision is.
  await page.locator('#stage').focus()
  for (let i = 0; i < 3; i++) await page.keyboard.press('ArrowLeft')
  await page.waitForTimeout(600)
  const box = await page.locator('#stage').boundingBox()
  const marks = await openMarks(page, box)
  await page.mouse.move(...marks.from)
  await page.mouse.down()
  await page.mouse.move(...marks.to, { steps: 12 })
  await page.mouse.up()
  await settled(page, 1)
  const summary = await page.locator('#seam-summary').textContent()
  const n = Number.parseInt(summary)
  assert.ok(n >= 2 && n <= 31, summary)
  await picture(page, 'brushed')

  // By keyboard, pair by pair.
  await page.locator('summary', { hasText: 'Single pairs' }).click()
  await page.locator('.pairs input:checked').first().focus()
  await page.keyboard.press('Space')
  await settled(page, 2)
  assert.equal(Number.parseInt(await page.locator('#seam-summary').textContent()), n - 1)
  assert.deepEqual(faults, [])
})

/** The leftmost and the rightmost mark of an open pair, by its colour, in pixels of the page. */
async function openMarks(page, box) {
  const image = await picture(page, 'brush')
  const colour = await page.evaluate(() =>
    getComputedStyle(document.documentElement).getPropertyValue('--pair-open').trim(),
  )
  const wanted = [1, 3, 5].map((at) => Number.parseInt(colour.slice(at, at + 2), 16))
  const found = []
  for (let i = 0; i < image.width * image.height; i++) {
    const at = i * image.channels
    if (wanted.every((value, k) => Math.abs(image.data[at + k] - value) < 12)) {
      found.push([i % image.width, Math.floor(i / image.width)])
    }
  }
  assert.ok(found.length > 20, 'no open pair is seen')
  found.sort((a, b) => a[0] - b[0])
  const onPage = ([px, py]) => [box.x + 60 + px, box.y + 70 + py]
  return { from: onPage(found[5]), to: onPage(found.at(-6)) }
}

test('a large body moves, and its frame times are recorded', async (t) => {
  const { vertices, tets } = bar([70, 20, 20])
  const folder = mkdtempSync(join(tmpdir(), 'sutura-bar-'))
  const files = ['bar.msh', 'bar.json'].map((name) => join(folder, name))
  writeFileSync(files[0], gmsh(vertices, tets))
  const [low, high] = [0, Math.max(...vertices.map(([x]) => x))]
  const fixed_vertices = vertices.flatMap(([x], i) => (x === low || x === high ? [i] : []))
  const material = { law: 'stvk', young_modulus_pa: 5e6, poisson_ratio: 0.4, density_kg_m3: 1000 }
  writeFileSync(files[1], JSON.stringify({ material, fixed_vertices }))
  const { page, faults } = await open()
  await page.locator('#new-session').click()
  await page.locator('#upload-files').setInputFiles(files)
  await page.getByRole('button', { name: 'Open session' }).click()
  rmSync(folder, { recursive: true })
  await page.locator('#generation', { hasText: 'generation 0' }).waitFor({ timeout: 600_000 })
  const rest = await picture(page, 'large-rest')
  assert.ok(drawn(rest) > 0.03)
  await page.getByLabel('Gravity').selectOption('9.81')
  await page.locator('#simulate').click()
  const times = page.locator('#frame-time')
  await page.waitForFunction(() => Number.parseFloat(document.querySelector('#time').textContent) > 4)
  const moved = await picture(page, 'large-moved')
  assert.ok(difference(rest, moved) > 1e-4, `${difference(rest, moved)}`)
  const [median, worst] = await Promise.all(
    ['data-median', 'data-worst'].map((name) => times.getAttribute(name)),
  )
  // Recorded, not judged: without a graphics card they tell little of a screen's.
  const record = { n_vertices: vertices.length, n_tets: tets.length, median_ms: median, worst_ms: worst }
  writeFileSync(join(OUTPUT, 'frame-times.json'), JSON.stringify(record))
  t.diagnostic(JSON.stringify(record))
  assert.ok(Number(median) > 0)
  assert.deepEqual(faults, [])
})

/** A mesh as Gmsh's format 2.2 has it. */
function gmsh(vertices, tets) {
  const nodes = vertices.map((x, i) => `${i + 1} ${x.join(' ')}`)
  const elements = tets.map((tet, i) => `${i + 1} 4 2 1 1 ${tet.map((v) => v + 1).join(' ')}`)
  const block = (name, lines) => [`$${name}`, String(lines.length), ...lines, `$End${name}`]
  const head = ['$MeshFormat', '2.2 0 8', '$EndMeshFormat']
  return [...head, ...block('Nodes', nodes), ...block('Elements', elements), ''].join('\n')
}

for (const colorScheme of ['light', 'dark']) {
  test(`nothing stands in the way of those who do not see or point, ${colorScheme}`, async () => {
    const { page, faults } = await open({ colorScheme })
    assert.deepEqual(await obstacles(page), [])
    await page.keyboard.press('Tab')
    for (let i = 0; i < 20; i++) {
      const focused = await page.evaluate(() => document.activeElement?.id)
      if (focused === 'new-session') break
      await page.keyboard.press('Tab')
    }
    await page.keyboard.press('Enter')
    await page.getByRole('dialog', { name: 'New session' }).waitFor()
    assert.deepEqual(await obstacles(page), [])
    await page.keyboard.press('Escape')
    await upload(page, 'fork_small')
    await page.locator('#stitch-all').click()
    await settled(page, 1)
    await page.evaluate(() => {
      for (const section of document.querySelectorAll('aside details')) section.open = true
    })
    assert.deepEqual(await obstacles(page), [])
    await picture(page, `everything-${colorScheme}`)
    assert.deepEqual(faults, [])
  })
}

test('a bad mesh is refused with its reason, and the form stays', async () => {
  const { page, faults } = await open({ colorScheme: 'dark' })
  await page.locator('#new-session').click()
  const name = 'broken.msh'
  const buffer = Buffer.from('$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n1\n1 0 0 zero\n')
  await page.locator('#upload-files').setInputFiles([{ name, mimeType: 'text/plain', buffer }])
  await page.getByRole('button', { name: 'Open session' }).click()
  await page.locator('dialog .problem', { hasText: /line 6/ }).waitFor()
  await picture(page, 'refused')
  // The browser notes every answer that is an error.
  assert.ok(faults.every((fault) => fault.includes('422') || fault.includes('400')), String(faults))
})

test('the viewer is served under a strict policy and kept by browsers', async () => {
  const reply = await fetch(`${daemon.address}/`)
  assert.match(reply.headers.get('content-security-policy'), /default-src 'none'; script-src 'self'/)
  assert.equal(reply.headers.get('cache-control'), 'no-cache')
  const held = { headers: { 'if-none-match': reply.headers.get('etag') } }
  assert.equal((await fetch(`${daemon.address}/`, held)).status, 304)
  const files = [...(await reply.text()).matchAll(/"(\/assets\/[^"]+)"/g)].map(([, path]) => path)
  assert.ok(files.some((path) => path.endsWith('.js')) && files.some((path) => path.endsWith('.css')))
  for (const path of files) {
    const file = await fetch(daemon.address + path)
    assert.equal(file.status, 200, path)
    assert.match(file.headers.get('cache-control'), /immutable/)
    if (path.endsWith('.js')) assert.match(file.headers.get('content-type'), /^text\/javascript/)
    assert.ok((await file.arrayBuffer()).byteLength > 0)
  }
  const missing = await fetch(`${daemon.address}/assets/none.js`)
  assert.equal(missing.status, 404)
  assert.match(missing.headers.get('content-type'), /problem/)
})
