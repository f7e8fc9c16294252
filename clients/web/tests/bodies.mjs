/** A small body to operate on: a bar cut in two, one half held, to be stitched together. */

import { setTimeout as sleep } from 'node:timers/promises'

/** Edge of a cell in m. */
const EDGE = 0.025
/** Stiffness of the stitches in N/m. */
export const STIFFNESS = 1e5
/** Vertices of each half. */
const N_HALF = 45
/** Columns of its basis. */
export const R = 20
/** A vertex at the free end. */
export const TIP = N_HALF + 4

/** Two halves of 4 × 2 × 2 cells of six tets, labelled 1 and 2, which meet at x = 0.1 m. */
export function bar([nx, ny, nz] = [4, 2, 2]) {
  const vertices = []
  const tets = []
  const domains = []
  // Kuhn's subdivision: one tet for each order in which the three axes can be walked; odd orders walk it
  // inside out.
  const walks = [
    [[0, 1, 2], false],
    [[1, 2, 0], false],
    [[2, 0, 1], false],
    [[0, 2, 1], true],
    [[2, 1, 0], true],
    [[1, 0, 2], true],
  ]
  for (let half = 0; half < 2; half++) {
    const first = vertices.length
    for (let k = 0; k <= nz; k++) {
      for (let j = 0; j <= ny; j++) {
        for (let i = 0; i <= nx; i++) {
          vertices.push([(i + half * nx) * EDGE, j * EDGE, k * EDGE])
        }
      }
    }
    const vertex = ([i, j, k]) => first + i + (nx + 1) * (j + (ny + 1) * k)
    for (let cell = 0; cell < nx * ny * nz; cell++) {
      const corner = [cell % nx, Math.floor(cell / nx) % ny, Math.floor(cell / (nx * ny))]
      for (const [axes, isOdd] of walks) {
        const place = [...corner]
        const tet = [vertex(corner)]
        for (const axis of axes) {
          place[axis] += 1
          tet.push(vertex(place))
        }
        if (isOdd) [tet[1], tet[2]] = [tet[2], tet[1]]
        tets.push(tet)
        domains.push(half + 1)
      }
    }
  }
  return { vertices, tets, domains }
}

/** Pairs of vertices of the two halves that meet. */
export function seam() {
  const { vertices } = bar()
  const pairs = []
  for (let a = 0; a < N_HALF; a++) {
    for (let b = N_HALF; b < 2 * N_HALF; b++) {
      if (vertices[a].every((x, axis) => x === vertices[b][axis])) pairs.push([a, b])
    }
  }
  return pairs
}

/** A session on the bar. */
export function config() {
  const { vertices } = bar()
  const held = vertices.flatMap(([x], vertex) => (x === 0 ? [vertex] : []))
  const material = {
    law: 'stvk',
    young_modulus_pa: 5e5,
    poisson_ratio: 0.4,
    density_kg_m3: 1000,
  }
  return {
    name: 'bar',
    mesh: bar(),
    material,
    fixed_vertices: held,
    n_modes: 8,
    basis: { size: R, n_derivative_modes: 5 },
    cubature: { n_points: 30, n_training_poses: 20, tolerance: 0.02, seed: 1 },
  }
}

/** An edit that stitches `pairs`. */
export function stitch(pairs) {
  return { edits: [{ stitch: { pairs, stiffness_n_m: STIFFNESS } }] }
}

/** Asks until it is so: a wait that ends. */
export async function until(isSo, what) {
  const deadline = Date.now() + 60_000
  while (!(await isSo())) {
    if (Date.now() > deadline) throw new Error(`not so yet: ${what}`)
    await sleep(20)
  }
}

/** The bytes of a typed array. */
export const bytesOf = (data) => Buffer.from(data.buffer, data.byteOffset, data.byteLength)
