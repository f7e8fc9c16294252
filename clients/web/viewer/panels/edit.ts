/** What the last edit made: its certificate and where its time went. */

import type { EditReply } from '../../client/index.js'
import type { App } from '../app.js'
import { element, section } from '../dom.js'
import { brief, milliseconds } from '../numbers.js'

const STAGES = [
  ['closing', 'closing'],
  ['linear', 'linear modes'],
  ['derivatives', 'derivatives'],
  ['reduction', 'basis and tables'],
  ['cubature', 'cubature'],
] as const

export function editPanel(app: App): HTMLElement {
  const body = element('div', { className: 'section-body', id: 'last-edit' })
  app.lastEdit.subscribe((reply) => {
    body.replaceChildren(
      ...(reply
        ? [timings(reply), certificate(reply), warnings(reply)]
        : [element('p', { className: 'hint' }, 'No edit of this session was made here.')]),
    )
  })
  const made = section('Last edit', true)
  made.querySelector('.section-body')?.replaceWith(body)
  return made
}

function timings(reply: EditReply): HTMLElement {
  const { total } = reply.timings_ms
  const parts: { key: string; text: string; ms: number }[] = STAGES.map(([key, text]) => ({
    key,
    text,
    ms: reply.timings_ms[key],
  }))
  const rest = total - parts.reduce((sum, { ms }) => sum + ms, 0)
  parts.push({ key: 'rest', text: 'waiting and the rest', ms: Math.max(0, rest) })
  const seen = parts.filter(({ ms }) => ms > 0.005 * total)
  const bar = element('div', { className: 'bar', attributes: { role: 'img' } })
  bar.setAttribute('aria-label', seen.map(({ text, ms }) => `${text} ${milliseconds(ms)}`).join(', '))
  for (const { key, ms, text } of seen) {
    const part = element('span', { className: `stage-${key}`, title: `${text}: ${milliseconds(ms)}` })
    part.style.flexGrow = String(ms)
    bar.append(part)
  }
  return element(
    'div',
    {},
    element(
      'p',
      { className: 'figure' },
      element('strong', { id: 'edit-total' }, milliseconds(total)),
      ` for generation ${reply.generation}`,
    ),
    bar,
    element(
      'ul',
      { className: 'legend' },
      ...seen.map(({ key, text, ms }) =>
        element(
          'li',
          {},
          element('span', { className: `swatch stage-${key}` }),
          element('span', {}, text),
          element('span', { className: 'number' }, milliseconds(ms)),
        ),
      ),
    ),
  )
}

const VERDICTS = {
  patched: 'from what was prepared, without a sparse solve',
  refined: 'with solves by the unedited body’s factorization',
  rebuilt: 'from a factorization of its own',
} as const

function certificate({ certificate }: EditReply): HTMLElement {
  const { verdict, is_met, is_unfinished } = certificate
  const rows = [
    ['Eigenvalue error, lower half', certificate.lower_eigenvalue_error],
    ['Eigenvalue error, upper half', certificate.upper_eigenvalue_error],
    ['Angle to the exact modes (sine)', certificate.basis_angle],
    ['Cubature force error', certificate.cubature_error ?? undefined],
  ] as const
  return element(
    'div',
    { className: 'certificate' },
    element(
      'p',
      {},
      element('span', { className: 'badge', id: 'verdict' }, verdict),
      ` ${VERDICTS[verdict]}`,
    ),
    element(
      'table',
      {},
      element('caption', { className: 'visually-hidden' }, 'Certificate'),
      element(
        'tbody',
        {},
        ...rows
          .filter(([, value]) => value !== undefined)
          .map(([text, value]) =>
            element(
              'tr',
              {},
              element('th', { scope: 'row' }, text),
              element('td', { className: 'number' }, brief(value!)),
            ),
          ),
      ),
    ),
    element(
      'p',
      { className: is_met ? 'met' : 'unmet', id: 'certificate-met' },
      is_unfinished
        ? 'The deadline left something undone: it follows.'
        : is_met
          ? 'Within the tolerances.'
          : 'Not within all tolerances.',
    ),
  )
}

function warnings({ warnings }: EditReply): HTMLElement {
  return element(
    'ul',
    { className: 'warnings', hidden: warnings.length === 0 },
    ...warnings.map((warning) => element('li', {}, warning)),
  )
}
