/** The list of sessions, with what each is doing. */

import type { SessionInfo } from '../../client/index.js'
import type { App } from '../app.js'
import { button, element } from '../dom.js'
import { count, plural } from '../numbers.js'

/** The column of sessions; `create` opens the form for a new one. */
export function sessionList(app: App, create: () => void): HTMLElement {
  const list = element('ul', { className: 'sessions' })
  const items = new Map<string, { node: HTMLLIElement; state: string }>()
  const render = () => {
    const sessions = app.sessions.value
    for (const [id, { node }] of items) {
      if (sessions.some((session) => session.id === id)) continue
      node.remove()
      items.delete(id)
    }
    sessions.forEach((session, place) => {
      const selected = session.id === app.selected.value
      const state = JSON.stringify([selected, shown(session)])
      const known = items.get(session.id)
      if (known?.state === state) return
      const node = item(app, session, selected)
      // What is focused stays so.
      const focused = known?.node.contains(document.activeElement)
      const focusedClass = document.activeElement?.className
      if (known) known.node.replaceWith(node)
      else list.insertBefore(node, list.children[place] ?? null)
      if (focused) {
        for (const control of node.querySelectorAll('button')) {
          if (control.className === focusedClass) control.focus()
        }
      }
      items.set(session.id, { node, state })
    })
    empty.hidden = sessions.length > 0
  }
  const empty = element('p', { className: 'hint' }, 'None yet. Drop a mesh anywhere to open one.')
  app.sessions.subscribe(render)
  app.selected.subscribe(render)
  return element(
    'nav',
    { className: 'column sessions-column', attributes: { 'aria-label': 'Sessions' } },
    element('h2', { className: 'column-title' }, 'Sessions'),
    list,
    empty,
    button('New session…', create, { className: 'primary wide', id: 'new-session' }),
  )
}

/** What of a session is shown in the list. */
function shown({ name, id, state, stage, progress, n_vertices, n_stitches }: SessionInfo) {
  return { name: name ?? id.slice(0, 8), state, stage, progress, n_vertices, n_stitches }
}

function item(app: App, session: SessionInfo, selected: boolean): HTMLLIElement {
  const { name, state, stage, progress, n_vertices, n_stitches } = shown(session)
  const isBusy = state === 'building' || state === 'rebuilding'
  const facts =
    state === 'failed'
      ? 'failed'
      : isBusy
        ? (stage ?? 'waiting')
        : `${count(n_vertices)} vertices\u2002·\u2002${plural(n_stitches, 'stitch', 'stitches')}`
  const open = element(
    'button',
    {
      type: 'button',
      className: 'session-open',
      on: { click: () => app.select(session.id) },
      attributes: { 'aria-current': String(selected), 'data-session': session.id },
    },
    element(
      'span',
      { className: 'session-name' },
      element('span', { className: `dot ${state}`, title: state }),
      name,
    ),
    element('span', { className: 'session-facts' }, facts),
    isBusy && element('progress', { max: 1, value: stage ? progress : 0, attributes: { 'aria-label': `${name}: ${stage}` } }),
  )
  const remove = button('×', () => {
    if (confirm(`Delete the session “${name}”? Its generations are lost.`)) void app.delete(session.id)
  })
  remove.className = 'quiet icon delete'
  remove.title = 'Delete'
  remove.setAttribute('aria-label', `Delete ${name}`)
  const fork = button('⑂', () => void app.fork(session.id))
  fork.className = 'quiet icon fork'
  fork.title = 'Fork: a second session that shares everything so far'
  fork.setAttribute('aria-label', `Fork ${name}`)
  fork.disabled = state === 'building' || state === 'failed'
  return element('li', { className: selected ? 'selected' : '' }, open, fork, remove)
}
