/** Numbers for people. */

/** `value` with about three significant digits. */
export function brief(value: number): string {
  const size = Math.abs(value)
  if (size !== 0 && (size < 1e-3 || size >= 1e5)) return value.toExponential(1)
  return Number(value.toPrecision(3)).toString()
}

/** A frequency in Hz with four digits: changes are often small. */
export function hertz(value: number): string {
  return value >= 1000 ? value.toFixed(0) : value.toPrecision(4)
}

/** A time in ms. */
export function milliseconds(value: number): string {
  if (value >= 1e4) return `${(value / 1e3).toFixed(1)} s`
  return `${value >= 100 ? value.toFixed(0) : Number(value.toPrecision(2))} ms`
}

/** A length in m. */
export function metres(value: number): string {
  const size = Math.abs(value)
  if (size >= 1) return `${brief(value)} m`
  if (size >= 1e-2) return `${brief(100 * value)} cm`
  return size >= 1e-6 || size === 0 ? `${brief(1000 * value)} mm` : `${brief(1e6 * value)} µm`
}

/** A force in N. */
export function newtons(value: number): string {
  return value < 0.1 ? `${brief(1000 * value)} mN` : `${brief(value)} N`
}

/** A count with thin spaces between thousands. */
export function count(value: number): string {
  return value.toLocaleString('en').replaceAll(',', '\u202f')
}

/** A count and what is counted. */
export function plural(n: number, one: string, many = `${one}s`): string {
  return `${count(n)} ${n === 1 ? one : many}`
}

/** A relative change in percent, signed. */
export function change(from: number, to: number): string {
  const percent = (100 * (to - from)) / from
  if (Math.abs(percent) < 0.005) return '±0 %'
  return `${percent > 0 ? '+' : '−'}${brief(Math.abs(percent))} %`
}
