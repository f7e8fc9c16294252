/**
 * u = Σ coefficient · column on the GPU: one fragment for each vertex of the surface, once a frame; then
 * one for each normal, from the triangles around the vertex. What is drawn reads both as textures.
 */

import * as three from 'three'
import { combine } from '../../client/index.js'
import type { Shapes } from '../../client/index.js'
import type { Surface } from '../body.js'
import { TABLE_WIDTH, floatTexture, pairTable, vectorTable, writeVectors } from './textures.js'

const VERTEX = /* glsl */ `
precision highp float;
in vec3 position;
void main() { gl_Position = vec4(position, 1.0); }
`

const POSITIONS = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D rest;
uniform sampler2D columns;
uniform sampler2D terms;
uniform int nTerms;
uniform int height;
out vec4 result;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 u = vec3(0.0);
  for (int k = 0; k < nTerms; ++k) {
    vec2 term = texelFetch(terms, ivec2(k % ${TABLE_WIDTH}, k / ${TABLE_WIDTH}), 0).xy;
    u += term.y * texelFetch(columns, ivec2(at.x, at.y + int(term.x) * height), 0).xyz;
  }
  result = vec4(texelFetch(rest, at, 0).xyz + u, length(u));
}
`

const NORMALS = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D positions;
uniform sampler2D fans;
uniform sampler2D corners;
uniform int width;
out vec4 result;
vec3 point(float row) {
  int at = int(row);
  return texelFetch(positions, ivec2(at % width, at / width), 0).xyz;
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 centre = texelFetch(positions, at, 0).xyz;
  int row = at.x + at.y * width;
  vec2 fan = texelFetch(fans, ivec2(row % ${TABLE_WIDTH}, row / ${TABLE_WIDTH}), 0).xy;
  vec3 sum = vec3(0.0);
  for (int k = int(fan.x); k < int(fan.x + fan.y); ++k) {
    vec2 others = texelFetch(corners, ivec2(k % ${TABLE_WIDTH}, k / ${TABLE_WIDTH}), 0).xy;
    sum += cross(point(others.x) - centre, point(others.y) - centre);
  }
  float size = length(sum);
  result = vec4(size > 0.0 ? sum / size : vec3(0.0, 0.0, 1.0), 0.0);
}
`

/** Columns in one texture, below each other. */
class ColumnAtlas {
  readonly texture: three.DataTexture
  readonly #slots = new Map<string, number>()

  constructor(shapes: Shapes, width: number, height: number) {
    const n = Math.max(1, shapes.columns.length)
    const data = new Float32Array(4 * width * height * n)
    shapes.columns.forEach(({ name, data: column }, slot) => {
      this.#slots.set(name, slot)
      writeVectors(data, slot * width * height, column)
    })
    this.texture = floatTexture(data, width, height * n)
  }

  /** Where the columns of `shapes` are, if all are here. */
  slots(shapes: Shapes): number[] | undefined {
    const slots = shapes.columns.map(({ name }) => this.#slots.get(name))
    return slots.includes(undefined) ? undefined : (slots as number[])
  }
}

/** Positions and normals of a deforming surface, as textures. */
export class Deformation {
  /** Texels of a row of the textures of positions and normals. */
  readonly width: number
  readonly #height: number
  readonly #n: number
  readonly #maxSize: number
  readonly #positions: three.WebGLRenderTarget
  readonly #normals: three.WebGLRenderTarget
  readonly #passes: { scene: three.Scene; material: three.RawShaderMaterial }[]
  readonly #camera = new three.Camera()
  readonly #fans: three.DataTexture[]
  #rest: three.DataTexture
  #given: Shapes | undefined
  #shapes: Shapes | undefined
  #atlas: ColumnAtlas | undefined
  #slots: number[] = []
  #terms = pairTable([])

  /** @param maxSize the largest texture that the GPU has */
  constructor(surface: Surface, positions: Float32Array, maxSize: number) {
    this.#n = surface.vertices.length
    this.#maxSize = maxSize
    this.width = Math.min(maxSize, 2 ** Math.ceil(Math.log2(Math.sqrt(this.#n * 160) + 1)))
    this.#height = Math.ceil(this.#n / this.width)
    const target = () =>
      new three.WebGLRenderTarget(this.width, this.#height, {
        type: three.FloatType,
        minFilter: three.NearestFilter,
        magFilter: three.NearestFilter,
        depthBuffer: false,
        generateMipmaps: false,
      })
    this.#positions = target()
    this.#normals = target()
    this.#fans = fansOf(surface)
    this.#rest = this.#restTexture(surface, positions)
    const [fans, corners] = this.#fans
    this.#passes = [
      pass(POSITIONS, {
        rest: { value: this.#rest },
        columns: { value: null },
        terms: { value: this.#terms },
        nTerms: { value: 0 },
        height: { value: this.#height },
      }),
      pass(NORMALS, {
        positions: { value: this.#positions.texture },
        fans: { value: fans },
        corners: { value: corners },
        width: { value: this.width },
      }),
    ]
  }

  /** Texels are rows of the surface; the fourth number is the size of the displacement. */
  get positions(): three.Texture {
    return this.#positions.texture
  }

  get normals(): three.Texture {
    return this.#normals.texture
  }

  /** From now on the body rests at `positions`. */
  setRest(surface: Surface, positions: Float32Array): void {
    this.#rest.dispose()
    this.#rest = this.#restTexture(surface, positions)
    this.#passes[0]!.material.uniforms['rest']!.value = this.#rest
  }

  /** Displacements are combined of the columns of `shapes` from now on. */
  setShapes(shapes: Shapes): void {
    if (shapes === this.#given) return
    this.#given = shapes
    const nFit = Math.floor(this.#maxSize / this.#height)
    shapes = shapes.columns.length <= nFit ? shapes : multipliedOut(shapes)
    this.#shapes = shapes
    const held = this.#atlas?.slots(shapes)
    if (held === undefined) {
      this.#atlas?.texture.dispose()
      this.#atlas = new ColumnAtlas(shapes, this.width, this.#height)
    }
    this.#slots = held ?? shapes.columns.map((_, slot) => slot)
    this.#passes[0]!.material.uniforms['columns']!.value = this.#atlas!.texture
    this.#terms.dispose()
    this.#terms = pairTable(new Float32Array(2 * shapes.columns.length))
    this.#passes[0]!.material.uniforms['terms']!.value = this.#terms
    this.#passes[0]!.material.uniforms['nTerms']!.value = 0
  }

  /** Computes positions and normals at the coordinates `q` of the shapes in use. */
  update(renderer: three.WebGLRenderer, q: ArrayLike<number>): void {
    if (this.#shapes === undefined) return
    const coefficients = this.#shapes.coefficients(q)
    const terms = this.#terms.image.data as Float32Array
    let nTerms = 0
    coefficients.forEach((coefficient, i) => {
      if (coefficient === 0) return
      terms[2 * nTerms] = this.#slots[i]!
      terms[2 * nTerms + 1] = coefficient
      nTerms += 1
    })
    this.#terms.needsUpdate = true
    this.#passes[0]!.material.uniforms['nTerms']!.value = nTerms
    const screen = renderer.getRenderTarget()
    const targets = [this.#positions, this.#normals]
    this.#passes.forEach(({ scene }, i) => {
      renderer.setRenderTarget(targets[i]!)
      renderer.render(scene, this.#camera)
    })
    renderer.setRenderTarget(screen)
  }

  /** Positions (rows, 4) as they were computed last. */
  read(renderer: three.WebGLRenderer): Float32Array {
    const pixels = new Float32Array(4 * this.width * this.#height)
    renderer.readRenderTargetPixels(this.#positions, 0, 0, this.width, this.#height, pixels)
    return pixels.subarray(0, 4 * this.#n)
  }

  dispose(): void {
    const textures = [...this.#fans, this.#rest, this.#terms, this.#atlas?.texture]
    for (const texture of textures) texture?.dispose()
    for (const target of [this.#positions, this.#normals]) target.dispose()
    for (const { material } of this.#passes) material.dispose()
  }

  #restTexture(surface: Surface, positions: Float32Array): three.DataTexture {
    const rows = new Float32Array(3 * this.#n)
    surface.vertices.forEach((vertex, row) => {
      rows.set(positions.subarray(3 * vertex, 3 * vertex + 3), 3 * row)
    })
    return vectorTable(rows, this.width)
  }
}

/** The same displacements from as many columns as there are coordinates: for textures that are too small. */
function multipliedOut(shapes: Shapes): Shapes {
  const columns = Array.from({ length: shapes.size }, (_, j) => {
    const unit = new Float64Array(shapes.size)
    unit[j] = 1
    const data = combine(shapes.columns, shapes.coefficients(unit))
    return { name: `generation ${shapes.generation}, coordinate ${j}`, data }
  })
  return { ...shapes, columns, coefficients: (q) => Float64Array.from(q) }
}

const TRIANGLE = new three.BufferGeometry().setAttribute(
  'position',
  new three.BufferAttribute(Float32Array.of(-1, -1, 0, 3, -1, 0, -1, 3, 0), 3),
)

function pass(fragmentShader: string, uniforms: Record<string, three.IUniform>) {
  const material = new three.RawShaderMaterial({
    glslVersion: three.GLSL3,
    vertexShader: VERTEX,
    fragmentShader,
    uniforms,
    depthTest: false,
    depthWrite: false,
  })
  const mesh = new three.Mesh(TRIANGLE, material)
  mesh.frustumCulled = false
  const scene = new three.Scene()
  scene.add(mesh)
  return { scene, material }
}

/** For each row where its fan begins and how many triangles it has; then their other two corners. */
function fansOf({ vertices, triangles }: Surface): three.DataTexture[] {
  const counts = new Uint32Array(vertices.length)
  for (const row of triangles) counts[row]! += 1
  const fans = new Float32Array(2 * vertices.length)
  let start = 0
  counts.forEach((n, row) => {
    fans.set([start, n], 2 * row)
    start += n
  })
  const corners = new Float32Array(2 * start)
  const filled = new Uint32Array(vertices.length)
  for (let i = 0; i < triangles.length; i += 3) {
    for (let k = 0; k < 3; k++) {
      const row = triangles[i + k]!
      const at = fans[2 * row]! + filled[row]!++
      corners[2 * at] = triangles[i + ((k + 1) % 3)]!
      corners[2 * at + 1] = triangles[i + ((k + 2) % 3)]!
    }
  }
  return [pairTable(fans), pairTable(corners)]
}
