/** The form for a new session: a mesh, and what it is made of. */

import type { SessionConfig, components } from '../../client/index.js'
import type { App, Hold } from '../app.js'
import { button, choice, element, field, numberInput } from '../dom.js'
import { plural } from '../numbers.js'

const PRESETS = {
  tissue: ['Soft tissue', 2e4, 0.45, 1050],
  gel: ['Gel', 5e4, 0.45, 1000],
  rubber: ['Rubber', 2e6, 0.45, 1100],
  wood: ['Green wood', 2e7, 0.35, 900],
} as const

const LAWS = [
  ['stvk', 'St. Venant–Kirchhoff'],
  ['neo_hookean', 'Stable neo-Hookean'],
  ['mooney_rivlin', 'Mooney–Rivlin'],
  ['corotational', 'Corotational'],
  ['linear', 'Linear'],
] as const satisfies readonly (readonly [components['schemas']['MaterialLaw'], string])[]

const HOLDS = {
  none: 'Nothing: it floats',
  'x-low': 'Its end at the lowest x',
  'x-high': 'Its end at the highest x',
  'y-low': 'Its end at the lowest y',
  'y-high': 'Its end at the highest y',
  'z-low': 'Its end at the lowest z',
  'z-high': 'Its end at the highest z',
} as const

/** Members of a configuration that the daemon knows. */
const MEMBERS = [
  'name',
  'material',
  'domain_materials',
  'fixed_vertices',
  'tet_stiffness',
  'mass',
  'n_modes',
  'basis',
  'cubature',
  'damping',
  'seams',
] as const

/** What was read from a configuration file. */
interface FromFile {
  readonly config: Partial<SessionConfig>
  readonly text: string
}

/** A dialog that opens sessions; `open` shows it, with files if there are some. */
export function uploadDialog(app: App): { dialog: HTMLDialogElement; open: (files?: File[]) => void } {
  let mesh: File[] = []
  let fromFile: FromFile | undefined

  const name = element('input', { type: 'text', maxLength: 180, placeholder: 'Name of the mesh file' })
  const chosen = element('p', { className: 'chosen' })
  const problem = element('p', { className: 'problem', attributes: { role: 'alert' } })
  const picker = element('input', {
    type: 'file',
    multiple: true,
    id: 'upload-files',
    className: 'visually-hidden',
    accept: '.msh,.veg,.vtk,.vtu,.node,.ele,.json',
    on: { change: () => void take([...(picker.files ?? [])]) },
  })
  const zone = element(
    'label',
    { className: 'drop-zone', htmlFor: 'upload-files' },
    element('strong', {}, 'Drop a mesh here, or choose one'),
    element('span', { className: 'hint' }, 'A tetrahedral mesh in metres, with a .json configuration beside it if there is one'),
    picker,
    chosen,
  )
  const law = choice(LAWS, 'stvk')
  const young = numberInput(2e4, 1e-3, 1e15)
  const poisson = numberInput(0.45, -0.99, 0.499)
  const density = numberInput(1050, 1e-3, 1e6)
  const preset = choice(
    Object.entries(PRESETS).map(([key, [text]]) => [key as keyof typeof PRESETS, text] as const),
    'tissue',
    (key) => {
      const [, e, nu, rho] = PRESETS[key]
      young.value = String(e)
      poisson.value = String(nu)
      density.value = String(rho)
    },
  )
  const material = element(
    'fieldset',
    {},
    element('legend', {}, 'Material'),
    element(
      'div',
      { className: 'grid' },
      field('Like', preset),
      field('Law', law),
      field('Young’s modulus, Pa', young),
      field('Poisson’s ratio', poisson),
      field('Density, kg/m³', density),
    ),
  )
  const hold = choice(
    Object.entries(HOLDS).map(([key, text]) => [key as keyof typeof HOLDS, text] as const),
    'none',
  )
  const depth = numberInput(3, 0, 100)
  const support = element(
    'fieldset',
    {},
    element('legend', {}, 'Support'),
    element('div', { className: 'grid' }, field('Hold', hold), field('Depth, % of its extent', depth)),
  )
  const modes = numberInput(30, 1, 200)
  const size = numberInput(60, 1, 400)
  const points = numberInput(120, 1, 4000)
  for (const input of [modes, size, points]) input.step = '1'
  const reduction = element(
    'details',
    {},
    element('summary', {}, 'Reduction'),
    element(
      'div',
      { className: 'grid' },
      field('Linear modes', modes),
      field('Columns of the basis', size),
      field('Cubature points', points),
    ),
  )
  const submit = element('button', { type: 'submit', className: 'primary' }, 'Open session')
  const form = element(
    'form',
    { method: 'dialog', on: { submit: (event: Event) => void send(event) } },
    element('h2', {}, 'New session'),
    zone,
    field('Name', name),
    material,
    support,
    reduction,
    problem,
    element('div', { className: 'row end' }, button('Cancel', () => dialog.close()), submit),
  )
  const dialog = element('dialog', { attributes: { 'aria-label': 'New session' } }, form)

  const show = () => {
    chosen.textContent = [...mesh.map((file) => file.name), fromFile?.text].filter(Boolean).join(' — ')
    material.hidden = fromFile?.config.material !== undefined || fromFile?.config.domain_materials !== undefined
    support.hidden = (fromFile?.config.fixed_vertices?.length ?? 0) > 0
    submit.disabled = mesh.length === 0
  }

  const take = async (files: File[]) => {
    problem.textContent = ''
    const isConfig = (file: File) => file.name.toLowerCase().endsWith('.json')
    const given = files.filter((file) => !isConfig(file))
    if (given.length > 0) {
      // TetGen's two files may come one after the other.
      mesh = [...mesh.filter((file) => isHalf(file) && given.every((other) => isOtherHalf(file, other))), ...given]
      if (name.value === '') name.value = given[0]!.name.replace(/\.[^.]*$/, '')
    }
    for (const file of files.filter(isConfig)) {
      try {
        fromFile = readConfig(file.name, await file.text())
        if (fromFile.config.name) name.value = fromFile.config.name
      } catch (error) {
        fromFile = undefined
        problem.textContent = `${file.name}: ${(error as Error).message}`
      }
    }
    show()
  }

  const send = async (event: Event) => {
    event.preventDefault()
    if (mesh.length === 0 || !form.reportValidity()) return
    submit.disabled = true
    problem.textContent = ''
    const numbers = { n_modes: Number(modes.value), basis: { size: Number(size.value) } }
    const config: SessionConfig = {
      ...(reduction.open || fromFile === undefined ? numbers : {}),
      ...(reduction.open || fromFile === undefined
        ? { cubature: { n_points: Number(points.value) } }
        : {}),
      ...(material.hidden
        ? {}
        : {
            material: {
              law: law.value,
              young_modulus_pa: Number(young.value),
              poisson_ratio: Number(poisson.value),
              density_kg_m3: Number(density.value),
            },
          }),
      ...fromFile?.config,
      name: name.value.trim() || mesh[0]!.name,
    }
    try {
      await app.create(mesh, config, support.hidden ? undefined : holdOf(hold.value, Number(depth.value)))
      dialog.close()
    } catch (error) {
      problem.textContent = (error as Error).message
    }
    submit.disabled = false
  }

  zone.addEventListener('dragover', (event) => event.preventDefault())
  return {
    dialog,
    open: (files = []) => {
      if (!dialog.open) {
        mesh = []
        fromFile = undefined
        name.value = ''
        picker.value = ''
        problem.textContent = ''
        dialog.showModal()
      }
      void take(files)
    },
  }
}

const HALF = /\.(node|ele)$/i

/** Whether a file is one of TetGen's two. */
function isHalf(file: File): boolean {
  return HALF.test(file.name)
}

function isOtherHalf(file: File, other: File): boolean {
  const ending = (name: string) => HALF.exec(name)?.[1]?.toLowerCase()
  return isHalf(other) && ending(file.name) !== ending(other.name)
}

function holdOf(value: keyof typeof HOLDS, percent: number): Hold | undefined {
  if (value === 'none') return undefined
  const [axis, end] = value.split('-') as ['x' | 'y' | 'z', 'low' | 'high']
  return { axis: { x: 0, y: 1, z: 2 }[axis] as 0 | 1 | 2, end, fraction: percent / 100 }
}

/** The configuration in a file: the daemon's own, or a description of a mesh that has some of it. */
export function readConfig(fileName: string, text: string): FromFile {
  const document: unknown = JSON.parse(text)
  if (typeof document !== 'object' || document === null || Array.isArray(document)) {
    throw new Error('not a configuration: its text is no JSON object')
  }
  const given = document as Record<string, unknown>
  const config: Record<string, unknown> = {}
  for (const member of MEMBERS) if (member in given) config[member] = given[member]
  // Descriptions of meshes name all pairs that lie on an incision, or those to be stitched.
  const pairs = given['seams'] ?? given['all_pairs'] ?? given['stitches']
  if (Array.isArray(pairs)) config['seams'] = pairs
  const found = config as Partial<SessionConfig>
  const facts = [
    (found.material ?? found.domain_materials) !== undefined && 'materials',
    found.fixed_vertices && plural(found.fixed_vertices.length, 'held vertex', 'held vertices'),
    found.seams && plural(found.seams.length, 'candidate pair'),
  ].filter(Boolean)
  if (facts.length === 0) throw new Error('nothing in it configures a session')
  return { config: found, text: `${fileName}: ${facts.join(', ')}` }
}
