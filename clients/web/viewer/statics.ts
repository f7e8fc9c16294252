/**
 * Small static problems K q = f in reduced coordinates, linear about the rest shape: how far a pull
 * moves a body, in the basis of its generation or, with the same stitches, in an older one.
 */

import type { Session, Shapes, Stitches } from '../client/index.js'
import type { GenerationData, Surface } from './body.js'

/** Three forces or displacements, or numbers, along x, y, z. */
export type Vector = readonly [number, number, number]

/** The reduced stiffness at rest in a basis, factorized. */
export class StaticModel {
  /** (r, number of columns): the coefficients of the columns, for each unit vector of q. */
  readonly #coefficients: Float64Array[]

  private constructor(
    private readonly shapes: Shapes,
    /** Rows of the lower Cholesky factor. */
    private readonly factor: Float64Array[],
  ) {
    this.#coefficients = unitCoefficients(shapes)
  }

  /**
   * The stiffness in the basis of `data` under the stitches `wanted`, which by default are its own; plus
   * `shift` in 1/s² times the mass, which is the identity.
   * Throws if the body is not held.
   */
  static async of(
    session: Session,
    surface: Surface,
    data: GenerationData,
    wanted: Stitches = data.stitches,
    shift = 0,
  ): Promise<StaticModel> {
    const { size } = data.shapes
    const q = new Array<number>(size).fill(0)
    const { stiffness } = await session.evaluate(q, { generation: data.generation })
    const matrix = stiffness.map((row) => Float64Array.from(row))
    const coefficients = unitCoefficients(data.shapes)
    const springs = [
      ...differenceOf(wanted, data.stitches).map((spring) => ({ ...spring, sign: 1 })),
      ...differenceOf(data.stitches, wanted).map((spring) => ({ ...spring, sign: -1 })),
    ]
    for (const { a, b, k, sign } of springs) {
      const [rowA, rowB] = [surface.rowOf[a] ?? -1, surface.rowOf[b] ?? -1]
      if (rowA < 0 || rowB < 0) continue
      const [atA, atB] = [rowsAt(data.shapes, coefficients, rowA), rowsAt(data.shapes, coefficients, rowB)]
      for (let axis = 0; axis < 3; axis++) {
        const gap = atA[axis]!.map((x, j) => x - atB[axis]![j]!)
        for (let i = 0; i < size; i++) {
          for (let j = 0; j < size; j++) matrix[i]![j]! += sign * k * gap[i]! * gap[j]!
        }
      }
    }
    for (let i = 0; i < size; i++) matrix[i]![i]! += shift
    return new StaticModel(data.shapes, cholesky(matrix))
  }

  /** The coordinates at rest under `force` (N) at the vertex of `row`. */
  respond(row: number, force: Vector): Float64Array {
    const at = rowsAt(this.shapes, this.#coefficients, row)
    const load = new Float64Array(this.shapes.size)
    for (let j = 0; j < load.length; j++) {
      load[j] = at[0]![j]! * force[0] + at[1]![j]! * force[1] + at[2]![j]! * force[2]
    }
    return solve(this.factor, load)
  }

  /** The displacement in m at `row` when the coordinates are `q`. */
  displacement(row: number, q: Float64Array): [number, number, number] {
    return displacementAt(this.shapes, row, q)
  }

  /** Mean compliance in m/N of the vertex of `row` over the three directions. */
  compliance(row: number): number {
    const units: Vector[] = [
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1],
    ]
    const moved = units.map((unit, axis) => this.displacement(row, this.respond(row, unit))[axis]!)
    return moved.reduce((sum, x) => sum + x, 0) / 3
  }
}

/** The displacement in m at `row` at the coordinates `q`. */
export function displacementAt(
  shapes: Shapes,
  row: number,
  q: ArrayLike<number>,
): [number, number, number] {
  const coefficients = shapes.coefficients(q)
  const sum: [number, number, number] = [0, 0, 0]
  shapes.columns.forEach(({ data }, i) => {
    const factor = coefficients[i]!
    for (let axis = 0; axis < 3; axis++) sum[axis]! += factor * data[3 * row + axis]!
  })
  return sum
}

function unitCoefficients(shapes: Shapes): Float64Array[] {
  return Array.from({ length: shapes.size }, (_, j) => {
    const unit = new Float64Array(shapes.size)
    unit[j] = 1
    return shapes.coefficients(unit)
  })
}

/** (3, r) rows of the basis at the vertex of `row`. */
function rowsAt(shapes: Shapes, coefficients: Float64Array[], row: number): Float64Array[] {
  return [0, 1, 2].map((axis) =>
    Float64Array.from(coefficients, (ofColumn) => {
      let sum = 0
      for (let i = 0; i < ofColumn.length; i++) {
        if (ofColumn[i] !== 0) sum += ofColumn[i]! * shapes.columns[i]!.data[3 * row + axis]!
      }
      return sum
    }),
  )
}

/** Stitches of `some` that `others` have not, or with another stiffness. */
function differenceOf(some: Stitches, others: Stitches) {
  const named = (stitches: Stitches) =>
    stitches.ids.map((_, i) => ({
      a: stitches.pairs[2 * i]!,
      b: stitches.pairs[2 * i + 1]!,
      k: stitches.stiffness[i]!,
    }))
  const key = ({ a, b, k }: { a: number; b: number; k: number }) => `${a},${b},${k}`
  const known = new Set(named(others).map(key))
  return named(some).filter((spring) => !known.has(key(spring)))
}

/** Rows of L with L·Lᵀ = `matrix`, which must be positive definite. */
export function cholesky(matrix: readonly Float64Array[]): Float64Array[] {
  const factor = matrix.map((row) => Float64Array.from(row))
  for (let i = 0; i < factor.length; i++) {
    const row = factor[i]!
    for (let j = 0; j <= i; j++) {
      const other = factor[j]!
      let sum = row[j]!
      for (let k = 0; k < j; k++) sum -= row[k]! * other[k]!
      if (i > j) row[j] = sum / other[j]!
      else if (sum > 1e-12 * matrix[i]![i]!) row[i] = Math.sqrt(sum)
      else throw new Error('nothing holds this body: a pull would move it without end')
    }
  }
  return factor
}

/** x with L·Lᵀ·x = `load`. */
export function solve(factor: readonly Float64Array[], load: Float64Array): Float64Array {
  const x = Float64Array.from(load)
  for (let i = 0; i < x.length; i++) {
    const row = factor[i]!
    for (let k = 0; k < i; k++) x[i]! -= row[k]! * x[k]!
    x[i]! /= row[i]!
  }
  for (let i = x.length - 1; i >= 0; i--) {
    for (let k = i + 1; k < x.length; k++) x[i]! -= factor[k]![i]! * x[k]!
    x[i]! /= factor[i]![i]!
  }
  return x
}
