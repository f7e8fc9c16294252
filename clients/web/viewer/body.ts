/** What is drawn of a session: its surface, and what each generation says of it. */

import { Tracker, boundaryTriangles, coincidentPairs } from '../client/index.js'
import type { Evaluator, Session, Shapes, Stitches } from '../client/index.js'

/** The surface of a mesh: its vertices are numbered anew, as rows. */
export interface Surface {
  /** The vertex of each row. */
  readonly vertices: Uint32Array
  /** The row of each vertex, −1 for those inside. */
  readonly rowOf: Int32Array
  /** (n, 3) rows of the triangles, outside anticlockwise. */
  readonly triangles: Uint32Array
}

/** Cubature points of a generation. */
export interface Cubature {
  readonly weights: Float32Array
  /** (p, 3) rest positions of the tets' centroids. */
  readonly centroids: Float32Array
  /** (p, 3, r) basis rows at the centroids. */
  readonly rows: Float32Array
  readonly size: number
}

/** What belongs to one generation. */
export interface GenerationData {
  readonly generation: number
  readonly shapes: Shapes
  /** (n_vertices, 3) rest positions. */
  readonly positions: Float32Array
  readonly stitches: Stitches
  readonly cubature: Cubature
}

/** Candidate pairs shown: beyond, they would neither be seen nor accepted at once. */
const MAX_PAIRS = 4096

/** The body of a ready session. */
export class Body {
  private constructor(
    readonly session: Session,
    readonly tets: Uint32Array,
    readonly surface: Surface,
    /** (n, 2) vertices that may be stitched. */
    readonly pairs: Uint32Array,
    readonly tracker: Tracker,
    /** Diagonal of the bounding box in m. */
    readonly diagonal: number,
    public current: GenerationData,
  ) {}

  /** Fetches everything that is drawn. */
  static async open(session: Session): Promise<Body> {
    const [tets, positions] = await Promise.all([session.tets(), session.positions()])
    const surface = surfaceOf(tets, positions.data)
    const pairs = coincidentPairs(positions.data, surface.vertices).slice(0, 2 * MAX_PAIRS)
    const tracker = await Tracker.open(session, { vertices: surface.vertices })
    const { diagonal } = bounds(positions.data)
    const generation = tracker.generation
    const current = await gather(session, tets, generation, tracker.shapes)
    return new Body(session, tets, surface, pairs, tracker, diagonal, current)
  }

  /** Goes over to `generation`. */
  async follow(generation: number): Promise<void> {
    await this.tracker.follow(generation)
    if (this.tracker.generation !== generation) return
    this.current = await gather(this.session, this.tets, generation, this.tracker.shapes)
  }

  /** What belongs to another generation, by a tracker of its own. */
  async other(generation: number): Promise<GenerationData> {
    const options = { vertices: this.surface.vertices }
    const { shapes } = await Tracker.open(this.session, options, generation)
    return gather(this.session, this.tets, generation, shapes)
  }

  /** Names of stitches in force by the places of their pairs in `pairs`. */
  stitchedPairs(stitches = this.current.stitches): Map<number, number> {
    const key = (a: number, b: number) => `${Math.min(a, b)},${Math.max(a, b)}`
    const ids = new Map(
      stitches.ids.map((id, i) => [key(stitches.pairs[2 * i]!, stitches.pairs[2 * i + 1]!), id]),
    )
    const stitched = new Map<number, number>()
    for (let i = 0; i < this.pairs.length / 2; i++) {
      const id = ids.get(key(this.pairs[2 * i]!, this.pairs[2 * i + 1]!))
      if (id !== undefined) stitched.set(i, id)
    }
    return stitched
  }

  /** Rows of the surface that never move. */
  heldRows(): Uint32Array {
    const { columns } = this.current.shapes
    const held = []
    for (let row = 0; row < this.surface.vertices.length; row++) {
      const moves = columns.some(
        ({ data }) => data[3 * row] !== 0 || data[3 * row + 1] !== 0 || data[3 * row + 2] !== 0,
      )
      if (!moves) held.push(row)
    }
    return Uint32Array.from(held)
  }
}

async function gather(
  session: Session,
  tets: Uint32Array,
  generation: number,
  shapes: Shapes,
): Promise<GenerationData> {
  const [positions, stitches, evaluator] = await Promise.all([
    session.positions(generation),
    session.stitches(generation),
    session.evaluator(generation),
  ])
  const cubature = cubatureOf(evaluator, tets, positions.data)
  return { generation, shapes, positions: positions.data, stitches, cubature }
}

function surfaceOf(tets: Uint32Array, positions: Float32Array): Surface {
  const nVertices = positions.length / 3
  const triangles = inOrder(boundaryTriangles(tets, nVertices), positions)
  const rowOf = new Int32Array(nVertices).fill(-1)
  const vertices: number[] = []
  const rows = triangles.map((vertex) => {
    if (rowOf[vertex] === -1) rowOf[vertex] = vertices.push(vertex) - 1
    return rowOf[vertex]!
  })
  return { vertices: Uint32Array.from(vertices), rowOf, triangles: rows }
}

/** Triangles along a Morton curve: those that share vertices are drawn soon after each other, while the GPU
 * still has these, and their rows lie near each other. */
function inOrder(triangles: Uint32Array, positions: Float32Array): Uint32Array {
  const { low, diagonal } = bounds(positions)
  const spread = (x: number) => {
    let bits = Math.min(1023, Math.max(0, Math.floor((1024 * x) / diagonal)))
    bits = (bits | (bits << 16)) & 0x030000ff
    bits = (bits | (bits << 8)) & 0x0300f00f
    bits = (bits | (bits << 4)) & 0x030c30c3
    return (bits | (bits << 2)) & 0x09249249
  }
  const keys = Float64Array.from({ length: triangles.length / 3 }, (_, i) => {
    const vertex = 3 * triangles[3 * i]!
    const [x, y, z] = [0, 1, 2].map((axis) => spread(positions[vertex + axis]! - low[axis]!))
    // The place of the triangle in the lower digits: they are sorted with their keys.
    return (x! + 2 * y! + 4 * z!) * 2 ** 22 + i
  })
  keys.sort()
  const ordered = new Uint32Array(triangles.length)
  keys.forEach((key, to) => {
    const from = 3 * (key % 2 ** 22)
    ordered.set(triangles.subarray(from, from + 3), 3 * to)
  })
  return ordered
}

/** Points shown; a body without cubature sums every tet, which nobody wants to see. */
const MAX_POINTS = 5000

function cubatureOf(evaluator: Evaluator, tets: Uint32Array, positions: Float32Array): Cubature {
  const { size, basisRows, weights } = evaluator
  const p = evaluator.tets.length <= MAX_POINTS ? evaluator.tets.length : 0
  const centroids = new Float32Array(3 * p)
  const rows = new Float32Array(3 * p * size)
  for (let point = 0; point < p; point++) {
    const tet = 4 * evaluator.tets[point]!
    for (let corner = 0; corner < 4; corner++) {
      const vertex = 3 * tets[tet + corner]!
      for (let axis = 0; axis < 3; axis++) {
        centroids[3 * point + axis]! += positions[vertex + axis]! / 4
        const from = ((4 * point + corner) * 3 + axis) * size
        const to = (3 * point + axis) * size
        for (let j = 0; j < size; j++) rows[to + j]! += basisRows[from + j]! / 4
      }
    }
  }
  return { weights: weights.subarray(0, p), centroids, rows, size }
}

/** Centre and diagonal of the bounding box. */
export function bounds(positions: Float32Array): {
  low: [number, number, number]
  high: [number, number, number]
  centre: [number, number, number]
  diagonal: number
} {
  const low: [number, number, number] = [Infinity, Infinity, Infinity]
  const high: [number, number, number] = [-Infinity, -Infinity, -Infinity]
  for (let i = 0; i < positions.length; i++) {
    const axis = i % 3
    low[axis] = Math.min(low[axis]!, positions[i]!)
    high[axis] = Math.max(high[axis]!, positions[i]!)
  }
  return {
    low,
    high,
    centre: [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2],
    diagonal: Math.hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]),
  }
}
