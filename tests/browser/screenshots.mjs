/**
 * Makes the pictures of docs/tutorial-browser.md: npm run screenshots, with the daemon built. They are kept with 160
 * colours (any quantizer will do): a quarter of the size.
 */

import { fileURLToPath } from 'node:url'
import { startDaemon } from '../../clients/web/scripts/daemon.mjs'
import { openPage } from './browser.mjs'

const DATA = fileURLToPath(new URL('../data/', import.meta.url))
const IMAGES = fileURLToPath(new URL('../../docs/images/', import.meta.url))

const daemon = await startDaemon()
const browser = await openPage(daemon.address, { viewport: { width: 1100, height: 640 }, colorScheme: 'light' })
const { page, faults } = browser
const shoot = (name) => page.screenshot({ path: `${IMAGES}viewer-${name}.png` })
const generation = (number) =>
  page.locator('#generation', { hasText: new RegExp(`^generation ${number}$`) }).waitFor()
const time = () => page.locator('#time').textContent().then(Number.parseFloat)
const simulated = (seconds) =>
  page.waitForFunction((until) => Number.parseFloat(document.querySelector('#time').textContent) > until, seconds)

try {
  await page.locator('#new-session').click()
  await page.locator('#upload-files').setInputFiles(['msh', 'json'].map((type) => `${DATA}stomach_small.${type}`))
  await page.waitForTimeout(500)
  await shoot('open')
  await page.getByRole('button', { name: 'Open session' }).click()
  await generation(0)
  await page.locator('#stage').focus()
  for (let i = 0; i < 3; i++) await page.keyboard.press('ArrowLeft')
  await page.keyboard.press('s')
  await page.waitForTimeout(800)
  await shoot('seam')
  await page.locator('#stitch-all').click()
  await generation(1)
  await page.waitForTimeout(500)
  await shoot('stitched')
  await page.keyboard.press('g')
  const { x, y, width, height } = await page.locator('#stage').boundingBox()
  await page.mouse.move(x + width * 0.42, y + height * 0.5)
  await page.mouse.down()
  await page.mouse.move(x + width * 0.62, y + height * 0.3, { steps: 8 })
  await page.locator('#pull-force', { hasText: 'Pulling with' }).waitFor()
  await simulated(1.5)
  await shoot('pulled')
  await page.mouse.up()
  await simulated((await time()) + 1)
  await page.locator('#simulate', { hasText: 'Stop' }).click()
  await page.locator('#simulate', { hasText: 'Start' }).waitFor()
  await page.locator('#compare').selectOption('0')
  await page.locator('#captions', { hasText: 'times as far: the old one locks' }).waitFor()
  await page.waitForTimeout(500)
  await shoot('compared')
  if (faults.length > 0) throw new Error(faults.join('\n'))
} finally {
  await browser.close()
  await daemon.stop()
}
