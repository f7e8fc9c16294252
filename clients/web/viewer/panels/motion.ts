/** The simulation, and what is marked on the body. */

import type { components } from '../../client/index.js'
import type { App } from '../app.js'
import { button, choice, element, field, section } from '../dom.js'
import type { Motion } from '../motion.js'
import { newtons } from '../numbers.js'
import type { Marks, Stage } from '../stage.js'
import type { Tools } from '../tools.js'

const INTEGRATORS = [
  ['implicit_newmark', 'Newmark'],
  ['backward_euler', 'Backward Euler'],
  ['modal_oscillators', 'Modal, linear'],
  ['quasi_static', 'Quasi-static'],
] as const satisfies readonly (readonly [components['schemas']['IntegratorConfig'], string])[]

export function motionPanel(app: App, motion: Motion, tools: Tools): HTMLElement {
  const toggle = button(
    'Start',
    () =>
      void (app.isSimulating.value
        ? app.stopSimulation()
        : motion.simulate()),
    { id: 'simulate' },
  )
  app.isSimulating.subscribe((running) => {
    toggle.textContent = running ? 'Stop' : 'Start'
    toggle.setAttribute('aria-pressed', String(running))
  })
  const pull = button('Pull with the mouse', () => (tools.tool.value = 'pull'))
  const gravity = choice(
    [
      ['0', 'None'],
      ['1', '1 m/s² down'],
      ['9.81', '9.81 m/s² down'],
    ],
    '0',
    (value) => {
      motion.gravity = Number(value)
      if (app.isSimulating.value) void motion.simulate()
    },
  )
  const integrator = choice(INTEGRATORS, 'implicit_newmark', (value) => {
    motion.integrator = value
    if (app.isSimulating.value) void motion.simulate()
  })
  const floor = element('input', {
    type: 'checkbox',
    id: 'floor',
    on: { change: () => motion.setFloor(floor.checked) },
  })
  const strength = element('input', {
    type: 'range',
    min: '-1',
    max: '1',
    step: '0.1',
    value: '0',
    on: { input: () => (motion.pullStrength = 10 ** Number(strength.value)) },
  })
  const force = element('p', { className: 'hint', id: 'pull-force' })
  motion.pullForce.subscribe((value) => {
    force.textContent =
      value === undefined
        ? 'A pull moves the vertex most of the way to the pointer.'
        : `Pulling with ${newtons(value)}`
  })
  return section(
    'Motion',
    true,
    element('div', { className: 'row' }, toggle, pull),
    element('div', { className: 'grid' }, field('Gravity', gravity), field('Integrator', integrator)),
    element('label', { className: 'check' }, floor, 'A floor below the body'),
    field('Strength of the pull', strength),
    force,
  )
}

export function displayPanel(stage: Stage): HTMLElement {
  const marks: Marks = { pairs: true, cubature: false, held: false, displacement: false }
  const box = (mark: keyof Marks, text: string) => {
    const input = element('input', {
      type: 'checkbox',
      checked: marks[mark],
      id: `show-${mark}`,
      on: {
        change: () => {
          marks[mark] = input.checked
          stage.setMarks({ ...marks })
        },
      },
    })
    return element('label', { className: 'check' }, input, text)
  }
  return section(
    'Shown',
    false,
    box('pairs', 'Candidate pairs'),
    box('cubature', 'Cubature points'),
    box('held', 'Held vertices'),
    box('displacement', 'Displacement as colour'),
    button('Whole body in view', () => stage.lookAtBody()),
  )
}

/** Holding and releasing ends of the body. */
export function supportPanel(app: App): HTMLElement {
  const axis = choice(
    [
      ['0', 'x'],
      ['1', 'y'],
      ['2', 'z'],
    ],
    '1',
  )
  const end = choice(
    [
      ['low', 'lowest'],
      ['high', 'highest'],
    ],
    'low',
  )
  const depth = element('input', { type: 'range', min: '0', max: '50', value: '3' })
  const chosen = () =>
    app.heldBy({
      axis: Number(axis.value) as 0 | 1 | 2,
      end: end.value,
      fraction: Number(depth.value) / 100,
    })
  const held = () => {
    const body = app.body.value
    return new Set(body ? Array.from(body.heldRows(), (row) => body.surface.vertices[row]!) : [])
  }
  const hold = button('Hold', () => {
    const already = held()
    const vertices = chosen().filter((vertex) => !already.has(vertex))
    if (vertices.length > 0) void app.edit([{ fix: { vertices } }])
    else app.notice.value = { kind: 'info', text: 'All of these are held already.' }
  })
  const release = button('Release', () => {
    const already = held()
    const vertices = chosen().filter((vertex) => already.has(vertex))
    if (vertices.length > 0) void app.edit([{ release: { vertices } }])
    else app.notice.value = { kind: 'info', text: 'None of these is held.' }
  })
  app.isEditing.subscribe((busy) => (hold.disabled = release.disabled = busy))
  return section(
    'Supports',
    false,
    element(
      'p',
      { className: 'hint' },
      'Vertices at one end of the body. Holding or releasing some factorizes the body anew.',
    ),
    element('div', { className: 'grid' }, field('End', end), field('Axis', axis)),
    field('Depth, % of the extent', depth),
    element('div', { className: 'row' }, hold, release),
  )
}
