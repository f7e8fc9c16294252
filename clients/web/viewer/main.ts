/** The viewer: puts the page together. */

import * as three from 'three'
import { App } from './app.js'
import { button, choice, element } from './dom.js'
import type { Palette } from './gpu/drawing.js'
import { Motion } from './motion.js'
import { metres, milliseconds, newtons } from './numbers.js'
import { editPanel } from './panels/edit.js'
import { modesPanel } from './panels/modes.js'
import { displayPanel, motionPanel, supportPanel } from './panels/motion.js'
import { seamPanel } from './panels/seam.js'
import { sessionList } from './panels/sessions.js'
import { uploadDialog } from './panels/upload.js'
import { Stage } from './stage.js'
import { Tools } from './tools.js'
import type { Tool } from './tools.js'

/** The daemon serves this page itself. */
const app = new App(location.origin)

const canvas = element('canvas', {
  tabIndex: 0,
  id: 'stage',
  attributes: {
    'aria-label': 'The body. Arrow keys turn it, plus and minus bring it nearer and farther.',
    role: 'application',
  },
})

function start(): void {
  let stage: Stage
  try {
    stage = new Stage(canvas, palette())
  } catch (error) {
    document.body.append(
      element('p', { className: 'fatal' }, `The viewer cannot draw: ${(error as Error).message}`),
    )
    return
  }
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => {
    stage.setPalette(palette())
  })
  const motion = new Motion(app, stage)
  const tools = new Tools(app, stage, motion)
  const upload = uploadDialog(app)
  document.body.append(
    header(stage, motion, tools),
    element(
      'main',
      {},
      sessionList(app, () => upload.open()),
      viewport(motion),
      panels(stage, motion, tools),
    ),
    upload.dialog,
    keyDialog(),
  )
  acceptDrops(upload.open)
  listenToKeys(stage, tools)
  followAddress()
  void app.watchList()
}

function header(stage: Stage, motion: Motion, tools: Tools): HTMLElement {
  const title = element('span', { className: 'title', id: 'title' })
  app.info.subscribe((info) => (title.textContent = info ? (info.name ?? info.id.slice(0, 8)) : ''))

  const choose = (tool: Tool, text: string, key: string) => {
    const made = button(text, () => (tools.tool.value = tool), { id: `tool-${tool}`, title: `${text} (${key})` })
    tools.tool.subscribe((current) => made.setAttribute('aria-pressed', String(current === tool)))
    return made
  }
  const undo = button('Undo', () => void app.undo(), { id: 'undo', title: 'Undo (Ctrl+Z)' })
  const redo = button('Redo', () => void app.redo(), { id: 'redo', title: 'Redo (Ctrl+Shift+Z)' })
  const showUndo = () => {
    undo.disabled = !app.canUndo || app.isEditing.value
    redo.disabled = !app.canRedo || app.isEditing.value
  }
  app.history.subscribe(showUndo)
  app.isEditing.subscribe(showUndo)

  const compare = element('span', { className: 'compare' })
  const rebuild = () => {
    const current = app.generation.value
    const older = [...new Set([...app.past].reverse())].filter((g) => g !== current)
    if (current !== undefined && current > 0 && !older.includes(0)) older.push(0)
    const select = choice(
      [['', 'One view'], ...older.map((g) => [String(g), `Beside generation ${g}`] as const)],
      String(motion.comparison.value?.old.generation ?? ''),
      (value) => void motion.compare(value === '' ? undefined : Number(value)),
    )
    select.id = 'compare'
    select.setAttribute('aria-label', 'Compare with an older basis')
    select.title = 'The same pull on the same stitched body, in an older basis and in the rebuilt one'
    select.disabled = older.length === 0
    compare.replaceChildren(select)
  }
  app.generation.subscribe(rebuild)
  app.history.subscribe(rebuild)
  motion.comparison.subscribe((comparison) => {
    const select = compare.querySelector('select')
    if (select) select.value = String(comparison?.old.generation ?? '')
  })

  const bar = element(
    'div',
    { className: 'toolbar', attributes: { role: 'toolbar', 'aria-label': 'Tools' } },
    element(
      'span',
      { className: 'segmented' },
      choose('orbit', 'Turn', 'V'),
      choose('pull', 'Pull', 'G'),
      choose('stitch', 'Stitch', 'S'),
    ),
    undo,
    redo,
    compare,
    button('Fit', () => stage.lookAtBody(), { title: 'Whole body in view (F)' }),
  )
  app.body.subscribe((body) => (bar.hidden = body === undefined))
  return element('header', {}, element('h1', { className: 'brand' }, 'Sutura'), title, bar)
}

function viewport(motion: Motion): HTMLElement {
  const generation = element('output', { id: 'generation', title: 'Generation shown' })
  app.generation.subscribe((value) => {
    generation.textContent = value === undefined ? '' : `generation ${value}`
  })
  const time = element('output', { id: 'time', title: 'Simulated time' })
  motion.state.subscribe((state) => {
    time.textContent = state ? `${state.timeSeconds.toFixed(1)} s` : ''
  })
  const pace = element('output', { id: 'frame-time', title: 'Median and longest of the latest frames' })

  const overlay = element('div', { className: 'overlay', id: 'overlay', attributes: { role: 'status' } })
  const showOverlay = () => {
    const [info, progress] = [app.info.value, app.progress.value]
    overlay.replaceChildren()
    overlay.hidden = app.body.value !== undefined
    if (info?.state === 'failed') {
      overlay.append(
        element('h2', {}, 'This body could not be prepared'),
        element('p', {}, info.error?.detail ?? ''),
      )
    } else if (app.selected.value !== undefined) {
      const done = progress?.done ?? 0
      overlay.append(
        element('h2', {}, info?.state === 'ready' ? 'Fetching the body…' : 'Preparing the body…'),
        element('progress', { max: 1, value: done, attributes: { 'aria-label': 'Progress' } }),
        element('p', { className: 'hint' }, progress?.stage ?? ''),
      )
    } else {
      overlay.append(
        element('h2', {}, 'Drop a tetrahedral mesh here'),
        element(
          'p',
          { className: 'hint' },
          'or choose a session on the left. Stitch an incision with the brush, pull at the body, and see its modes follow.',
        ),
      )
    }
  }
  for (const signal of [app.info, app.progress, app.body, app.selected]) signal.subscribe(showOverlay)

  const busy = element('div', { className: 'busy', attributes: { role: 'status' } })
  const showBusy = () => {
    busy.hidden = !app.isEditing.value
    busy.textContent = `Rebuilding${app.progress.value ? `: ${app.progress.value.stage}` : '…'}`
  }
  app.isEditing.subscribe(showBusy)
  app.progress.subscribe(showBusy)

  const captions = element('div', { className: 'captions', id: 'captions' })
  motion.comparison.subscribe((comparison) => {
    captions.hidden = comparison === undefined
    if (!comparison) return
    const { old, moved, force } = comparison
    const ratio = moved[1] / moved[0]
    captions.replaceChildren(
      element(
        'figcaption',
        {},
        element('strong', {}, `Basis of generation ${old.generation}, stitched`),
        ` moves ${metres(moved[0])} under ${newtons(force)}`,
      ),
      element(
        'figcaption',
        {},
        element('strong', {}, 'Rebuilt basis'),
        ` moves ${metres(moved[1])}`,
        ratio > 1.02 ? `, ${Number(ratio.toPrecision(2))} times as far: the old one locks` : '',
      ),
    )
  })

  const notice = element('div', { className: 'notice', id: 'notice', attributes: { role: 'alert' } })
  app.notice.subscribe((value) => {
    notice.hidden = value === undefined
    notice.className = `notice ${value?.kind ?? ''}`
    notice.replaceChildren(
      value?.text ?? '',
      button('×', () => (app.notice.value = undefined), {
        className: 'quiet icon',
        title: 'Close',
        attributes: { 'aria-label': 'Close the message' },
      }),
    )
  })
  const shell = element(
    'section',
    { className: 'viewport', attributes: { 'aria-label': 'Body' } },
    canvas,
    captions,
    overlay,
    busy,
    notice,
    element('div', { className: 'hud' }, generation, time, pace),
  )
  stageFrameTime = (median, worst) => {
    pace.textContent = `${milliseconds(median)} a frame`
    pace.dataset['median'] = median.toFixed(2)
    pace.dataset['worst'] = worst.toFixed(2)
  }
  return shell
}

let stageFrameTime: (median: number, worst: number) => void = () => undefined

function panels(stage: Stage, motion: Motion, tools: Tools): HTMLElement {
  stage.frameTime.subscribe((value) => value && stageFrameTime(value.median, value.worst))
  const column = element(
    'aside',
    { className: 'column panels', attributes: { 'aria-label': 'Body and edits' } },
    seamPanel(app, tools),
    editPanel(app),
    motionPanel(app, motion, tools),
    modesPanel(app, motion),
    supportPanel(app),
    displayPanel(stage),
  )
  app.body.subscribe((body) => (column.hidden = body === undefined))
  return column
}

function keyDialog(): HTMLElement {
  const key = element('input', { type: 'password', autocomplete: 'off', required: true })
  const form = element(
    'form',
    {
      method: 'dialog',
      on: {
        submit: () => {
          app.setKey(key.value)
          key.value = ''
        },
      },
    },
    element('h2', {}, 'This daemon wants a key'),
    element('label', { className: 'field' }, element('span', { className: 'field-name' }, 'Key'), key),
    element('p', { className: 'hint' }, 'It is kept until this tab is closed.'),
    element('div', { className: 'row end' }, element('button', { className: 'primary' }, 'Use it')),
  )
  const dialog = element('dialog', { attributes: { 'aria-label': 'Key' } }, form)
  // Without a key there is nothing to go back to.
  dialog.addEventListener('cancel', (event) => event.preventDefault())
  app.needsKey.subscribe((needed) => {
    if (needed && !dialog.open) dialog.showModal()
  })
  return dialog
}

/** Files dropped anywhere open the form for a new session. */
function acceptDrops(open: (files: File[]) => void): void {
  const isFiles = (event: DragEvent) => event.dataTransfer?.types.includes('Files') ?? false
  window.addEventListener('dragover', (event) => {
    if (!isFiles(event)) return
    event.preventDefault()
    document.body.classList.add('dropping')
  })
  window.addEventListener('dragleave', (event) => {
    if (event.relatedTarget === null) document.body.classList.remove('dropping')
  })
  window.addEventListener('drop', (event) => {
    document.body.classList.remove('dropping')
    if (!isFiles(event)) return
    event.preventDefault()
    open([...(event.dataTransfer?.files ?? [])])
  })
}

const TURN = Math.PI / 24

function listenToKeys(stage: Stage, tools: Tools): void {
  const tools_: Record<string, Tool> = { v: 'orbit', g: 'pull', s: 'stitch' }
  const turns: Record<string, [number, number, number]> = {
    ArrowLeft: [-TURN, 0, 1],
    ArrowRight: [TURN, 0, 1],
    ArrowUp: [0, TURN, 1],
    ArrowDown: [0, -TURN, 1],
    '+': [0, 0, 1.15],
    '=': [0, 0, 1.15],
    '-': [0, 0, 1 / 1.15],
  }
  canvas.addEventListener('keydown', (event) => {
    const turn = turns[event.key]
    if (!turn || event.ctrlKey || event.metaKey) return
    event.preventDefault()
    stage.orbit(...turn)
  })
  window.addEventListener('keydown', (event) => {
    const target = event.target as HTMLElement
    if (target.closest('input:not([type=checkbox], [type=range]), select, textarea, dialog')) return
    const key = event.key.toLowerCase()
    if ((event.ctrlKey || event.metaKey) && key === 'z') {
      event.preventDefault()
      void (event.shiftKey ? app.redo() : app.undo())
    } else if (!event.ctrlKey && !event.metaKey && !event.altKey) {
      const tool = tools_[key]
      if (tool) tools.tool.value = tool
      else if (key === 'f') stage.lookAtBody()
    }
  })
}

/** The session selected stands in the address, so that it can be kept and passed on. */
function followAddress(): void {
  const read = () => app.select(/^#\/sessions\/([\w-]+)$/.exec(location.hash)?.[1])
  window.addEventListener('hashchange', read)
  read()
  app.selected.subscribe((id) => {
    const hash = id === undefined ? '' : `#/sessions/${id}`
    if (location.hash !== hash) history.replaceState(null, '', hash || location.pathname)
  })
}

/** Colours from the page's style. */
function palette(): Palette {
  const style = getComputedStyle(document.documentElement)
  const colour = (name: string) => new three.Color(style.getPropertyValue(`--${name}`).trim())
  return {
    body: colour('body-outside'),
    inside: colour('body-inside'),
    moved: colour('body-moved'),
    open: colour('pair-open'),
    stitched: colour('pair-stitched'),
    touched: colour('pair-touched'),
    cubature: colour('cubature'),
    held: colour('held'),
    pull: colour('pull'),
  }
}

start()
