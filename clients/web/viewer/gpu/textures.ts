/** Tables of numbers as textures, which shaders read texel by texel. */

import * as three from 'three'

/** Texels of one row of a table that is as wide as convenient. */
export const TABLE_WIDTH = 1024

/** A texture of `height` rows of `width` texels, four (or two) f32 each, never filtered. */
export function floatTexture(
  data: Float32Array,
  width: number,
  height: number,
  format: typeof three.RGBAFormat | typeof three.RGFormat = three.RGBAFormat,
): three.DataTexture {
  const texture = new three.DataTexture(data, width, height, format, three.FloatType)
  texture.minFilter = texture.magFilter = three.NearestFilter
  texture.needsUpdate = true
  return texture
}

/** Vectors (n, 3) as a table of width `width`. */
export function vectorTable(vectors: ArrayLike<number>, width: number): three.DataTexture {
  const n = vectors.length / 3
  const height = Math.max(1, Math.ceil(n / width))
  const data = new Float32Array(4 * width * height)
  writeVectors(data, 0, vectors)
  return floatTexture(data, width, height)
}

/** Pairs of numbers (n, 2) as a table of width {@link TABLE_WIDTH}. */
export function pairTable(pairs: ArrayLike<number>): three.DataTexture {
  const height = Math.max(1, Math.ceil(pairs.length / 2 / TABLE_WIDTH))
  const data = new Float32Array(2 * TABLE_WIDTH * height)
  data.set(pairs)
  return floatTexture(data, TABLE_WIDTH, height, three.RGFormat)
}

/** Writes vectors (n, 3) as texels of four from the texel `start` on. */
export function writeVectors(
  data: Float32Array,
  start: number,
  vectors: ArrayLike<number>,
): void {
  for (let i = 0, to = 4 * start; i < vectors.length; i += 3, to += 4) {
    data[to] = vectors[i]!
    data[to + 1] = vectors[i + 1]!
    data[to + 2] = vectors[i + 2]!
  }
}
