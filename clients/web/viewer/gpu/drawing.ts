/** What is drawn of a body: its surface, the marks on it, and a pull. */

import * as three from 'three'
import type { Cubature, Surface } from '../body.js'
import type { Deformation } from './deformation.js'

/** What a candidate pair looks like. */
export enum PairState {
  Open,
  Stitched,
  /** Under the brush. */
  Touched,
}

/** Colours of everything, from the page's style. */
export interface Palette {
  readonly body: three.Color
  readonly inside: three.Color
  readonly moved: three.Color
  readonly open: three.Color
  readonly stitched: three.Color
  readonly touched: three.Color
  readonly cubature: three.Color
  readonly held: three.Color
  readonly pull: three.Color
}

const AT_ROW = /* glsl */ `
uniform sampler2D positions;
uniform int width;
vec4 pointAt(float row) {
  int at = int(row);
  return texelFetch(positions, ivec2(at % width, at / width), 0);
}
`

const SURFACE_VERTEX = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
${AT_ROW}
uniform sampler2D normals;
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
uniform mat3 normalMatrix;
out vec3 normal;
out vec3 eye;
out float moved;
void main() {
  vec4 place = pointAt(float(gl_VertexID));
  ivec2 at = ivec2(gl_VertexID % width, gl_VertexID / width);
  vec4 seen = modelViewMatrix * vec4(place.xyz, 1.0);
  normal = normalMatrix * texelFetch(normals, at, 0).xyz;
  eye = -seen.xyz;
  moved = place.w;
  gl_Position = projectionMatrix * seen;
}
`

const SURFACE_FRAGMENT = /* glsl */ `
precision highp float;
uniform vec3 body;
uniform vec3 inside;
uniform vec3 accent;
uniform float scale;
in vec3 normal;
in vec3 eye;
in float moved;
out vec4 colour;
void main() {
  vec3 n = normalize(gl_FrontFacing ? normal : -normal);
  vec3 toEye = normalize(eye);
  vec3 base = gl_FrontFacing ? body : inside;
  if (scale > 0.0) base = mix(base, accent, smoothstep(0.0, 1.0, moved * scale));
  float sky = 0.5 + 0.5 * n.y;
  float key = max(dot(n, normalize(vec3(0.45, 0.65, 0.8))), 0.0);
  float fill = max(dot(n, normalize(vec3(-0.7, -0.1, 0.4))), 0.0);
  float rim = pow(1.0 - max(dot(n, toEye), 0.0), 3.0);
  vec3 halfway = normalize(toEye + normalize(vec3(0.45, 0.65, 0.8)));
  float gloss = pow(max(dot(n, halfway), 0.0), 48.0);
  vec3 light = base * (0.40 + 0.22 * sky + 0.42 * key + 0.16 * fill);
  colour = vec4(light + 0.10 * rim + 0.10 * gloss, 1.0);
}
`

const PAIR_VERTEX = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
${AT_ROW}
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
uniform float size;
uniform vec3 colours[3];
in vec2 rows;
in float state;
flat out vec3 tint;
void main() {
  tint = colours[int(state)];
  vec3 place = 0.5 * (pointAt(rows.x).xyz + pointAt(rows.y).xyz);
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(place, 1.0));
  gl_Position.z -= 0.004 * gl_Position.w;
  gl_PointSize = state > 1.5 ? 1.5 * size : size;
}
`

const DISC_FRAGMENT = /* glsl */ `
precision highp float;
uniform float opacity;
flat in vec3 tint;
out vec4 colour;
void main() {
  float radius = length(gl_PointCoord - 0.5) * 2.0;
  float edge = fwidth(radius);
  float alpha = 1.0 - smoothstep(1.0 - edge, 1.0, radius);
  vec3 ringed = mix(tint, vec3(1.0), smoothstep(0.62, 0.70, radius) * 0.85);
  colour = vec4(ringed, alpha * opacity);
}
`

const MARK_VERTEX = /* glsl */ `
precision highp float;
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
uniform float size;
uniform vec3 tintOf;
in vec3 position;
in float weight;
flat out vec3 tint;
void main() {
  tint = tintOf;
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
  gl_Position.z -= 0.002 * gl_Position.w;
  gl_PointSize = size * weight;
}
`

const ROW_VERTEX = /* glsl */ `
precision highp float;
precision highp int;
precision highp sampler2D;
${AT_ROW}
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
uniform float size;
uniform vec3 tintOf;
in float row;
flat out vec3 tint;
void main() {
  tint = tintOf;
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(pointAt(row).xyz, 1.0));
  gl_Position.z -= 0.002 * gl_Position.w;
  gl_PointSize = size;
}
`

/** A body in a scene. All its parts follow the same {@link Deformation}. */
export class Drawing {
  readonly group = new three.Group()
  readonly #surface: three.Mesh<three.BufferGeometry, three.RawShaderMaterial>
  readonly #pairs: three.Points<three.BufferGeometry, three.RawShaderMaterial>[]
  readonly #cubature: three.Points<three.BufferGeometry, three.RawShaderMaterial>
  readonly #held: three.Points<three.BufferGeometry, three.RawShaderMaterial>
  readonly #pull: three.Line<three.BufferGeometry, three.LineBasicMaterial>
  readonly #ends: three.Points<three.BufferGeometry, three.RawShaderMaterial>
  readonly #diagonal: number
  #points: Cubature | undefined

  constructor(surface: Surface, pairs: Uint32Array, deformation: Deformation, diagonal: number) {
    this.#diagonal = diagonal
    const shared = {
      positions: { value: deformation.positions },
      width: { value: deformation.width },
    }
    const geometry = new three.BufferGeometry()
    geometry.setIndex(new three.BufferAttribute(surface.triangles, 1))
    this.#surface = new three.Mesh(
      geometry,
      material(SURFACE_VERTEX, SURFACE_FRAGMENT, {
        ...shared,
        normals: { value: deformation.normals },
        body: { value: new three.Color() },
        inside: { value: new three.Color() },
        accent: { value: new three.Color() },
        scale: { value: 0 },
      }),
    )
    this.#surface.material.side = three.DoubleSide

    const marks = new three.BufferGeometry()
    const rows = Float32Array.from(pairs, (vertex) => surface.rowOf[vertex]!)
    marks.setAttribute('rows', new three.BufferAttribute(rows, 2))
    const states = new Float32Array(rows.length / 2)
    marks.setAttribute('state', new three.BufferAttribute(states, 1))
    marks.setDrawRange(0, rows.length / 2)
    const colours = { value: [new three.Color(), new three.Color(), new three.Color()] }
    // Those behind the surface shine through faintly.
    this.#pairs = [0.3, 1].map((opacity) => {
      const disc = material(PAIR_VERTEX, DISC_FRAGMENT, {
        ...shared,
        colours,
        size: { value: 8 },
        opacity: { value: opacity },
      })
      disc.depthTest = opacity === 1
      return new three.Points(marks, disc)
    })
    this.#cubature = markedPoints(MARK_VERTEX, {}, 1)
    this.#cubature.material.depthTest = false
    this.#held = markedPoints(ROW_VERTEX, shared, 1)
    this.#ends = markedPoints(MARK_VERTEX, {}, 1)
    this.#ends.material.depthTest = false
    const line = new three.BufferGeometry()
    line.setAttribute('position', new three.BufferAttribute(new Float32Array(6), 3))
    this.#pull = new three.Line(line, new three.LineBasicMaterial({ depthTest: false }))
    this.#ends.geometry.setAttribute('position', line.getAttribute('position'))
    const weights = new three.BufferAttribute(Float32Array.of(1, 1), 1)
    this.#ends.geometry.setAttribute('weight', weights)
    this.showPull(undefined)
    const parts = [this.#surface, this.#held, ...this.#pairs, this.#cubature, this.#pull, this.#ends]
    parts.forEach((part, order) => {
      part.frustumCulled = false
      part.renderOrder = order
      this.group.add(part)
    })
  }

  /** Colours, and the size of marks in pixels of the screen. */
  setPalette(palette: Palette, pixelRatio: number): void {
    const { uniforms } = this.#surface.material
    uniforms['body']!.value = palette.body
    uniforms['inside']!.value = palette.inside
    uniforms['accent']!.value = palette.moved
    for (const { material } of this.#pairs) {
      material.uniforms['colours']!.value = [palette.open, palette.stitched, palette.touched]
      material.uniforms['size']!.value = 9.5 * pixelRatio
    }
    this.#cubature.material.uniforms['tintOf']!.value = palette.cubature
    this.#cubature.material.uniforms['size']!.value = 16 * pixelRatio
    this.#held.material.uniforms['tintOf']!.value = palette.held
    this.#held.material.uniforms['size']!.value = 5 * pixelRatio
    this.#ends.material.uniforms['tintOf']!.value = palette.pull
    this.#ends.material.uniforms['size']!.value = 12 * pixelRatio
    this.#pull.material.color.copy(palette.pull)
  }

  /** Whether the surface shows how far it has moved. */
  showDisplacement(show: boolean): void {
    this.#surface.material.uniforms['scale']!.value = show ? 8 / this.#diagonal : 0
  }

  showPairs(show: boolean): void {
    for (const points of this.#pairs) points.visible = show
  }

  /** What each pair looks like. */
  setPairStates(stateOf: (pair: number) => PairState): void {
    const attribute = this.#pairs[0]!.geometry.getAttribute('state') as three.BufferAttribute
    for (let i = 0; i < attribute.count; i++) attribute.setX(i, stateOf(i))
    attribute.needsUpdate = true
  }

  /** Marks the vertices that are held. */
  setHeld(rows: Uint32Array, show: boolean): void {
    const { geometry } = this.#held
    geometry.setAttribute('row', new three.BufferAttribute(Float32Array.from(rows), 1))
    geometry.setDrawRange(0, rows.length)
    this.#held.visible = show && rows.length > 0
  }

  /** Marks the cubature points, larger where their weight is. */
  setCubature(cubature: Cubature, show: boolean): void {
    this.#points = cubature
    const { geometry } = this.#cubature
    const n = cubature.weights.length
    const largest = cubature.weights.reduce((most, weight) => Math.max(most, weight), 1e-30)
    const sizes = cubature.weights.map((weight) => 0.45 + 0.55 * Math.cbrt(weight / largest))
    geometry.setAttribute('position', new three.BufferAttribute(new Float32Array(3 * n), 3))
    geometry.setAttribute('weight', new three.BufferAttribute(sizes, 1))
    geometry.setDrawRange(0, n)
    this.#cubature.visible = show && n > 0
  }

  /** Moves what the processor moves: the cubature points, to the coordinates `q`. */
  moveTo(q: ArrayLike<number>): void {
    if (this.#points === undefined || !this.#cubature.visible) return
    const { centroids, rows, size } = this.#points
    const attribute = this.#cubature.geometry.getAttribute('position') as three.BufferAttribute
    for (let i = 0; i < centroids.length; i++) {
      let u = 0
      if (q.length === size) for (let j = 0; j < size; j++) u += rows[i * size + j]! * q[j]!
      attribute.array[i] = centroids[i]! + u
    }
    attribute.needsUpdate = true
  }

  /** A line from the vertex pulled at to where it is pulled. */
  showPull(ends: { from: three.Vector3; to: three.Vector3 } | undefined): void {
    this.#pull.visible = this.#ends.visible = ends !== undefined
    if (ends === undefined) return
    const attribute = this.#pull.geometry.getAttribute('position') as three.BufferAttribute
    attribute.setXYZ(0, ends.from.x, ends.from.y, ends.from.z)
    attribute.setXYZ(1, ends.to.x, ends.to.y, ends.to.z)
    attribute.needsUpdate = true
  }

  dispose(): void {
    for (const part of this.group.children) {
      const { geometry, material } = part as three.Mesh<three.BufferGeometry, three.Material>
      geometry.dispose()
      material.dispose()
    }
  }
}

function material(
  vertexShader: string,
  fragmentShader: string,
  uniforms: Record<string, three.IUniform>,
): three.RawShaderMaterial {
  const isDisc = fragmentShader === DISC_FRAGMENT
  return new three.RawShaderMaterial({
    glslVersion: three.GLSL3,
    vertexShader,
    fragmentShader,
    uniforms,
    transparent: isDisc,
    depthWrite: !isDisc,
  })
}

function markedPoints(
  vertexShader: string,
  shared: Record<string, three.IUniform>,
  opacity: number,
): three.Points<three.BufferGeometry, three.RawShaderMaterial> {
  const disc = material(vertexShader, DISC_FRAGMENT, {
    ...shared,
    size: { value: 8 },
    tintOf: { value: new three.Color() },
    opacity: { value: opacity },
  })
  const geometry = new three.BufferGeometry()
  geometry.setDrawRange(0, 0)
  if (vertexShader === MARK_VERTEX) geometry.setDrawRange(0, 2)
  const points = new three.Points(geometry, disc)
  points.visible = false
  return points
}
