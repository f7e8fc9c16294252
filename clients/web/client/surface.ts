/** The surface of a tetrahedral mesh. */

/** Faces of a tet (0, 1, 2, 3) of positive volume, seen from outside anticlockwise. */
const FACES = [
  [0, 2, 1],
  [0, 1, 3],
  [1, 2, 3],
  [0, 3, 2],
] as const

/**
 * The faces that belong to one tet alone, three vertices each, outside anticlockwise.
 *
 * @param tets (n, 4) corners of positively oriented tets
 */
export function boundaryTriangles(tets: Uint32Array, nVertices: number): Uint32Array {
  // Faces are sorted into buckets by their smallest vertex; a bucket holds a few dozen.
  const starts = new Uint32Array(nVertices + 1)
  const nFaces = tets.length
  const smallest = new Uint32Array(nFaces)
  for (let face = 0; face < nFaces; face++) {
    const [a, b, c] = corners(tets, face)
    const least = Math.min(a, b, c)
    smallest[face] = least
    starts[least + 1]! += 1
  }
  for (let v = 0; v < nVertices; v++) starts[v + 1]! += starts[v]!
  const ends = starts.slice(0, nVertices)
  const sorted = new Uint32Array(nFaces)
  for (let face = 0; face < nFaces; face++) sorted[ends[smallest[face]!]!++] = face

  const isShared = new Uint8Array(nFaces)
  let nShared = 0
  for (let v = 0; v < nVertices; v++) {
    for (let i = starts[v]!; i < starts[v + 1]!; i++) {
      const face = sorted[i]!
      if (isShared[face]) continue
      const [a, b, c] = corners(tets, face)
      for (let k = i + 1; k < starts[v + 1]!; k++) {
        const other = sorted[k]!
        if (isShared[other]) continue
        const [x, y, z] = corners(tets, other)
        // Both have v as their smallest vertex: they are one face if the other two agree as well.
        if (a + b + c === x + y + z && Math.max(a, b, c) === Math.max(x, y, z)) {
          isShared[face] = isShared[other] = 1
          nShared += 2
          break
        }
      }
    }
  }
  const triangles = new Uint32Array(3 * (nFaces - nShared))
  let end = 0
  for (let face = 0; face < nFaces; face++) {
    if (!isShared[face]) {
      triangles.set(corners(tets, face), end)
      end += 3
    }
  }
  return triangles
}

function corners(tets: Uint32Array, face: number): [number, number, number] {
  const tet = face - (face % 4)
  const [i, j, k] = FACES[face % 4]!
  return [tets[tet + i]!, tets[tet + j]!, tets[tet + k]!]
}

/** Pairs of vertices at one place, which a stitch may join: of each place all pairs. */
export function coincidentPairs(positions: ArrayLike<number>, vertices: Uint32Array): Uint32Array {
  const places = new Map<string, number[]>()
  for (const vertex of vertices) {
    const at = `${positions[3 * vertex]},${positions[3 * vertex + 1]},${positions[3 * vertex + 2]}`
    const there = places.get(at)
    if (there === undefined) places.set(at, [vertex])
    else there.push(vertex)
  }
  const pairs: number[] = []
  for (const there of places.values()) {
    there.sort((a, b) => a - b)
    there.forEach((a, i) => there.slice(i + 1).forEach((b) => pairs.push(a, b)))
  }
  return Uint32Array.from(pairs)
}
