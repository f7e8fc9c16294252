/** Frequencies before and after the last edit, and a slider for each mode. */

import type { App } from '../app.js'
import { button, element, section } from '../dom.js'
import type { Motion } from '../motion.js'
import { change, hertz } from '../numbers.js'

export function modesPanel(app: App, motion: Motion): HTMLElement {
  const rows = element('tbody')
  const still = button('All still', () => {
    for (const slider of sliders) slider.value = '0'
    apply()
  })
  let sliders: HTMLInputElement[] = []
  const apply = () => {
    const amplitudes = Float64Array.from(sliders, (slider) => Number(slider.value))
    still.disabled = amplitudes.every((amplitude) => amplitude === 0)
    motion.setAmplitudes(amplitudes).catch((error: unknown) => app.report(error))
  }
  const show = () => {
    const generation = app.generation.value
    const now = generation === undefined ? [] : (app.frequencies.get(generation) ?? [])
    const previous = app.past.at(-1)
    const before = previous === undefined ? undefined : app.frequencies.get(previous)
    const values = sliders.map((slider) => slider.value)
    sliders = now.map((frequency, k) => {
      const slider = element('input', {
        type: 'range',
        min: '-1',
        max: '1',
        step: '0.05',
        value: values[k] ?? '0',
        attributes: { 'aria-label': `Amplitude of mode ${k + 1}, ${hertz(frequency)} Hz` },
        on: { input: apply },
      })
      return slider
    })
    rows.replaceChildren(
      ...now.map((frequency, k) => {
        const old = before?.[k]
        return element(
          'tr',
          {},
          element('th', { scope: 'row' }, String(k + 1)),
          element('td', { className: 'number before' }, old === undefined ? '' : hertz(old)),
          element('td', { className: 'number after' }, hertz(frequency)),
          element(
            'td',
            { className: 'number change' },
            old === undefined || old === 0 ? '' : change(old, frequency),
          ),
          element('td', {}, sliders[k]),
        )
      }),
    )
    still.disabled = sliders.every((slider) => slider.value === '0')
  }
  app.generation.subscribe(show)
  app.history.subscribe(show)
  const column = (text: string) => element('th', { scope: 'col' }, text)
  return section(
    'Modes',
    true,
    element(
      'div',
      { className: 'table-scroll', tabIndex: 0, attributes: { role: 'region', 'aria-label': 'Modes' } },
      element(
        'table',
        { className: 'modes', id: 'modes' },
        element(
          'thead',
          {},
          element('tr', {}, column('#'), column('before, Hz'), column('now, Hz'), column('by'), column('swing')),
        ),
        rows,
      ),
    ),
    still,
  )
}
