/** Which part of a deformed surface a ray meets. */

/** Where a ray meets a surface first. */
export interface Hit {
  /** Distance along the ray. */
  readonly distance: number
  /** The row of the triangle's corner that is nearest. */
  readonly row: number
  readonly point: readonly [number, number, number]
}

/**
 * The first triangle that the ray from `origin` along the unit vector `direction` meets, from either side.
 *
 * @param positions (rows, 4), of which three are used
 * @param triangles (n, 3) rows
 */
export function castRay(
  origin: readonly [number, number, number],
  direction: readonly [number, number, number],
  positions: Float32Array,
  triangles: Uint32Array,
): Hit | undefined {
  const [ox, oy, oz] = origin
  const [dx, dy, dz] = direction
  let nearest = Infinity
  let found = -1
  for (let i = 0; i < triangles.length; i += 3) {
    const a = 4 * triangles[i]!
    const b = 4 * triangles[i + 1]!
    const c = 4 * triangles[i + 2]!
    const ax = positions[a]!
    const ay = positions[a + 1]!
    const az = positions[a + 2]!
    const ux = positions[b]! - ax
    const uy = positions[b + 1]! - ay
    const uz = positions[b + 2]! - az
    const vx = positions[c]! - ax
    const vy = positions[c + 1]! - ay
    const vz = positions[c + 2]! - az
    const px = dy * vz - dz * vy
    const py = dz * vx - dx * vz
    const pz = dx * vy - dy * vx
    const determinant = ux * px + uy * py + uz * pz
    if (determinant === 0) continue
    const tx = ox - ax
    const ty = oy - ay
    const tz = oz - az
    const s = (tx * px + ty * py + tz * pz) / determinant
    if (!(s >= 0 && s <= 1)) continue
    const qx = ty * uz - tz * uy
    const qy = tz * ux - tx * uz
    const qz = tx * uy - ty * ux
    const t = (dx * qx + dy * qy + dz * qz) / determinant
    if (!(t >= 0 && s + t <= 1)) continue
    const distance = (vx * qx + vy * qy + vz * qz) / determinant
    if (distance > 0 && distance < nearest) {
      nearest = distance
      found = i
    }
  }
  if (found < 0) return undefined
  const point = [ox + nearest * dx, oy + nearest * dy, oz + nearest * dz] as const
  const gap = (row: number) =>
    Math.hypot(...point.map((x, axis) => x - positions[4 * row + axis]!))
  const rows = Array.from(triangles.subarray(found, found + 3))
  const row = rows.reduce((best, other) => (gap(other) < gap(best) ? other : best))
  return { distance: nearest, row, point }
}
