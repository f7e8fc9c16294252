/** Candidate pairs and the stitches in force. */

import type { App } from '../app.js'
import { button, choice, element, field, numberInput, section } from '../dom.js'
import { plural } from '../numbers.js'
import type { Tools } from '../tools.js'

/** Rows of the list of pairs; a longer seam is stitched with the brush. */
const MAX_ROWS = 600

export function seamPanel(app: App, tools: Tools): HTMLElement {
  const summary = element('p', { id: 'seam-summary' })
  const prepared = element('p', { className: 'hint', id: 'prepared-pairs' })
  const prepare = button('Prepare the seam', () => void app.prepareSeams(), {
    title: 'Names all candidate pairs, so that edits of them take no sparse solve',
  })
  const brush = button('Brush', () => (tools.tool.value = 'stitch'))
  const all = button('Stitch all', () => void app.stitch(places()), { id: 'stitch-all' })
  const none = button('Open all', () => void app.edit([{ unstitch_all: {} }]), { id: 'open-all' })
  const stiffness = numberInput(app.options.stiffness, 1e-9, 1e15)
  stiffness.addEventListener('change', () => {
    if (stiffness.checkValidity()) app.options.stiffness = Number(stiffness.value)
  })
  const method = choice(
    [
      ['flexibility', 'Flexibility: exact, incremental'],
      ['low_rank', 'Low rank: the published update'],
      ['from_scratch', 'From scratch: the oracle'],
    ],
    'flexibility',
    (value) => (app.options.method = value),
  )
  const deadline = choice(
    [
      ['0', 'When it is finished'],
      ['100', 'Within 100 ms, finished behind it'],
    ],
    '0',
    (value) => (app.options.deadline = Number(value)),
  )
  const list = element('ol', { className: 'pairs' })
  const pairs = element('details', {}, element('summary', {}, 'Single pairs'), list)
  const places = () => Array.from({ length: (app.body.value?.pairs.length ?? 0) / 2 }, (_, i) => i)

  const fill = () => {
    const body = app.body.value
    list.replaceChildren()
    if (!body || !pairs.open) return
    const stitched = body.stitchedPairs()
    for (const place of places().slice(0, MAX_ROWS)) {
      const box = element('input', {
        type: 'checkbox',
        checked: stitched.has(place),
        disabled: app.isEditing.value,
        on: { change: () => void (box.checked ? app.stitch([place]) : app.unstitch([place])) },
      })
      const [a, b] = body.pairs.subarray(2 * place, 2 * place + 2)
      list.append(element('li', {}, element('label', {}, box, ` ${a} – ${b}`)))
    }
    if (places().length > MAX_ROWS) {
      list.append(element('li', { className: 'hint' }, 'The others with the brush.'))
    }
  }
  pairs.addEventListener('toggle', fill)

  const body = element(
    'div',
    { className: 'section-body' },
    summary,
    element('div', { className: 'row' }, brush, all, none),
    prepared,
    prepare,
    element(
      'details',
      {},
      element('summary', {}, 'How'),
      element(
        'div',
        { className: 'folded' },
        field('Stiffness of a stitch, N/m', stiffness),
        field('Modes follow by', method),
        field('Answer', deadline),
      ),
    ),
    pairs,
  )
  const show = () => {
    const shown = app.body.value
    const n = places().length
    const nStitched = shown?.stitchedPairs().size ?? 0
    const nPrepared = app.info.value?.n_prepared_pairs ?? 0
    const isBusy = app.isEditing.value
    summary.textContent =
      n === 0
        ? 'No vertices of this body lie at one place: there is nothing to stitch.'
        : `${nStitched} of ${plural(n, 'candidate pair')} stitched.`
    prepared.textContent =
      n === 0 ? '' : `Prepared: ${nPrepared} of ${n}. Edits of prepared pairs take no sparse solve.`
    const nNamed = app.info.value?.parameters?.n_seam_pairs ?? 0
    prepare.hidden = n === 0 || Math.max(nPrepared, nNamed) >= n
    for (const control of [brush, all, none, prepare]) control.disabled = isBusy || n === 0
    all.disabled ||= nStitched === n
    none.disabled ||= (shown?.current.stitches.ids.length ?? 0) === 0
    fill()
  }
  app.generation.subscribe(show)
  app.info.subscribe(show)
  app.isEditing.subscribe(show)
  const made = section('Seam', true)
  made.querySelector('.section-body')?.replaceWith(body)
  return made
}
