/** Making elements. */

type Child = Node | string | null | undefined | false
type Properties<K extends keyof HTMLElementTagNameMap> = {
  [P in Exclude<keyof HTMLElementTagNameMap[K], 'attributes'>]?: HTMLElementTagNameMap[K][P]
} & {
  /** Attributes that are no properties, such as `aria-label`. */
  attributes?: Record<string, string>
  on?: { [E in keyof HTMLElementEventMap]?: (event: HTMLElementEventMap[E]) => void }
}

/** An element with properties and children. */
export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Properties<K> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const { attributes, on, ...own } = properties
  const made = document.createElement(tag)
  Object.assign(made, own)
  const given = Object.entries(attributes ?? {})
  for (const [name, value] of given) made.setAttribute(name, value)
  for (const [name, listener] of Object.entries(on ?? {})) {
    made.addEventListener(name, listener as EventListener)
  }
  made.append(...children.filter((child): child is Node | string => Boolean(child)))
  return made
}

/** A button that says what it does. */
export function button(
  text: string,
  act: () => void,
  properties: Properties<'button'> = {},
): HTMLButtonElement {
  return element('button', { type: 'button', ...properties, on: { click: act } }, text)
}

/** A control under its label. */
export function field(text: string, control: HTMLElement, hint?: string): HTMLLabelElement {
  return element(
    'label',
    { className: 'field' },
    element('span', { className: 'field-name' }, text),
    control,
    hint && element('span', { className: 'hint' }, hint),
  )
}

/** A number to be typed. */
export function numberInput(value: number, min: number, max: number): HTMLInputElement {
  const properties = { type: 'number', min: String(min), max: String(max), step: 'any' }
  return element('input', { ...properties, value: String(value), required: true })
}

/** A choice of one of `options`: value and text. */
export function choice<V extends string>(
  options: readonly (readonly [V, string])[],
  value: V,
  changed?: (value: V) => void,
): HTMLSelectElement & { value: V } {
  const made = element('select', {
    on: { change: () => changed?.(made.value as V) },
  })
  for (const [key, text] of options) made.append(element('option', { value: key }, text))
  made.value = value
  return made as HTMLSelectElement & { value: V }
}

/** A section of a column that can be folded. */
export function section(title: string, open: boolean, ...children: Child[]): HTMLDetailsElement {
  return element(
    'details',
    { className: 'section', open },
    element('summary', {}, element('h2', {}, title)),
    element('div', { className: 'section-body' }, ...children),
  )
}
