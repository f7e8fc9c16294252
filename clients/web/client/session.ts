/** One session over HTTP: its edits, the arrays of its generations, its simulation. */

import type { DType } from './array.js'
import { Arrays } from './arrays.js'
import type { ArrayOptions, Generation } from './arrays.js'
import { decodeEvents } from './events.js'
import type { SessionEvent } from './events.js'
import { FRAME_MEDIA_TYPE, decodeFrame } from './frame.js'
import type { Frame } from './frame.js'
import type { Client, SessionInfo } from './http.js'
import { ProblemError } from './problem.js'
import type { components } from './schema.js'
import { StateStream } from './states.js'

type Schemas = components['schemas']
/** Changes that take effect together or not at all. */
export type EditRequest = Schemas['EditRequest']
/** One change. */
export type Edit = Schemas['Edit']
/** What an edit made. */
export type EditReply = Schemas['EditReply']
/** How a session is simulated. */
export type SimulationConfig = Schemas['SimulationConfig']
/** A running simulation. */
export type SimulationInfo = Schemas['SimulationInfo']
/** A force on one vertex for some time. */
export type Force = Schemas['Force']
/** A damped spring from a vertex to a point in the world. */
export type Grab = Schemas['Grab']
/** Energy, force and stiffness at some coordinates. */
export type Evaluation = Schemas['Evaluation']

/** A session of a daemon. Answers that are no success are thrown as {@link ProblemError}. */
export class Session extends Arrays {
  readonly #client: Client
  readonly #path: string

  constructor(
    client: Client,
    /** Its identifier. */
    readonly id: string,
  ) {
    super()
    this.#client = client
    this.#path = `/v1/sessions/${encodeURIComponent(id)}`
  }

  /** What is known of it now. */
  info(signal?: AbortSignal): Promise<SessionInfo> {
    return this.#client.document(this.#path, { signal })
  }

  /** Waits until its build has ended; throws its problem if it failed. */
  async waitReady(onEvent?: (event: SessionEvent) => void): Promise<SessionInfo> {
    const stop = new AbortController()
    try {
      for await (const event of this.events(stop.signal)) {
        onEvent?.(event)
        if (event.event === 'failed') throw new ProblemError(event.error)
        if (event.event === 'deleted') break
        const state = event.event === 'state' ? event.state : undefined
        if (state === 'ready' || state === 'rebuilding') return await this.info()
        if (state === 'failed') break
      }
    } finally {
      stop.abort()
    }
    const info = await this.info()
    if (info.error) throw new ProblemError(info.error)
    return info
  }

  /** Its events: where things stand, then every change, until it ends or `signal` aborts. */
  async *events(signal?: AbortSignal): AsyncGenerator<SessionEvent, void, undefined> {
    const accept = 'text/event-stream'
    const response = await this.#client.request(`${this.#path}/events`, { accept, signal })
    if (response.body) yield* decodeEvents(response.body)
  }

  /** Ends it and everything that runs for it. */
  async delete(): Promise<void> {
    await this.#client.request(this.#path, { method: 'DELETE' })
  }

  /** Opens a session with the same generations, sharing every artifact. */
  async fork(name?: string): Promise<Session> {
    const body = name === undefined ? {} : { name }
    const fork = { method: 'POST', body } as const
    const info = await this.#client.document<SessionInfo>(`${this.#path}/fork`, fork)
    return this.#client.session(info.id)
  }

  /** Makes the next generation. Aborting cancels the edit. */
  edit(request: EditRequest, signal?: AbortSignal): Promise<EditReply> {
    return this.#client.document(`${this.#path}/edits`, { method: 'POST', body: request, signal })
  }

  /** Names candidate pairs, which are then prepared in the background. */
  addSeams(pairs: readonly (readonly [number, number])[]): Promise<Schemas['SeamReply']> {
    return this.#client.document(`${this.#path}/seams`, { method: 'POST', body: { pairs } })
  }

  /** Energy, force and tangent stiffness of the reduced model at the coordinates `q`. */
  evaluate(
    q: readonly number[],
    { generation, exact = false }: { generation?: Generation; exact?: boolean } = {},
  ): Promise<Evaluation> {
    const at = generation === undefined ? '' : `/generations/${generation}`
    const body = { q, exact }
    return this.#client.document(`${this.#path}${at}/evaluate`, { method: 'POST', body })
  }

  /** Starts the simulation, or changes how it goes on. */
  simulate(config: SimulationConfig = {}): Promise<SimulationInfo> {
    return this.#client.document(`${this.#path}/simulation`, { method: 'PUT', body: config })
  }

  /** The simulation that is running. */
  simulation(signal?: AbortSignal): Promise<SimulationInfo> {
    return this.#client.document(`${this.#path}/simulation`, { signal })
  }

  /** Ends the simulation. */
  async stopSimulation(): Promise<void> {
    await this.#client.request(`${this.#path}/simulation`, { method: 'DELETE' })
  }

  /** Lets forces act on vertices for some time. */
  async pushForces(forces: readonly Force[]): Promise<void> {
    const body = { forces }
    await this.#client.request(`${this.#path}/simulation/forces`, { method: 'POST', body })
  }

  /** Takes hold of vertices, or moves what holds on; lets go of the grabs named in `release`. */
  async grab(grabs: readonly Grab[], release: readonly number[] = []): Promise<void> {
    const path = `${this.#path}/simulation/grabs`
    // What is let go as a page is closed is let go all the same.
    await this.#client.request(path, { method: 'POST', body: { grabs, release }, keepalive: true })
  }

  /** Published states of this and of later simulations, until the session ends. */
  states(): StateStream {
    return new StateStream(...this.#client.socket(`${this.#path}/stream`))
  }

  override async frame(
    resource: string,
    generation: Generation,
    { dtype, signal }: ArrayOptions<DType> = {},
    query: Record<string, string | number> = {},
  ): Promise<Frame> {
    const path = `${this.#path}/generations/${generation}/${resource}`
    const request = { accept: FRAME_MEDIA_TYPE, query: { dtype: dtype ?? 'f32', ...query }, signal }
    return decodeFrame(await this.#client.bytes(path, request))
  }
}
