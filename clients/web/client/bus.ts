/**
 * A daemon over Zenoh, by way of a bridge that speaks Zenoh's remote API over a WebSocket
 * (`zenoh-bridge-remote-api`) and of the package `@eclipse-zenoh/zenoh-ts`, which is the user's: nothing here imports it.
 *
 * ```ts
 * import { Config, open } from '@eclipse-zenoh/zenoh-ts'
 * const client = new BusClient(await open(new Config('ws/127.0.0.1:10000')))
 * const reply = await client.session(id).edit({ edits: [{ unstitch_all: {} }] })
 * ```
 */

import type { DType } from './array.js'
import { Arrays } from './arrays.js'
import type { ArrayOptions, Generation } from './arrays.js'
import { decodeFrame } from './frame.js'
import type { Frame } from './frame.js'
import type { SessionInfo } from './http.js'
import { ProblemError } from './problem.js'
import type { components } from './schema.js'
import type { EditReply, EditRequest, Force, Grab } from './session.js'
import { decodeState } from './state.js'
import type { StateFrame } from './state.js'
import { Arrivals } from './states.js'

type Schemas = components['schemas']

const PREFIX = 'sutura/v1'
const JSON_ENCODING = 'application/json'
/** How long an answer may take: an edit of a large body takes seconds, from scratch minutes. */
const QUERY_TIMEOUT = { type: 'MILLISECONDS', valueType: 'TYPED_DURATION', unit: 'ms', value: 600_000 } as const
/** Zenoh's priorities: of what is small, of arrays of many megabytes, of what a hand does. */
const PRIORITY = { small: 5, arrays: 6, hand: 1 } as const
/** Zenoh's congestion control for what is worth nothing late. */
const DROP = 0

/** Bytes that Zenoh carries. */
interface Payload {
  payload(): { toBytes(): Uint8Array }
}

/** An answer to a query: a sample, which has a key, or an error, which has none. */
export interface ZenohReply {
  result(): Payload
}

/** A subscription. */
export interface ZenohSubscriber {
  undeclare(): Promise<void>
}

/** What is used of a `Session` of `@eclipse-zenoh/zenoh-ts`. */
export interface ZenohSession {
  get(selector: string, options: object): Promise<AsyncIterable<ZenohReply> | undefined>
  put(key: string, payload: string, options: object): Promise<void>
  declareSubscriber(
    key: string,
    options: { handler: (sample: Payload) => void },
  ): Promise<ZenohSubscriber>
}

/** The daemons of a Zenoh network. */
export class BusClient {
  readonly #zenohSession: ZenohSession
  readonly #key: string | undefined

  /** @param options `key`: the one that the daemons want with every query, if they want one */
  constructor(zenohSession: ZenohSession, options: { readonly key?: string } = {}) {
    this.#zenohSession = zenohSession
    this.#key = options.key
  }

  /** The session named `id`, whether or not it exists. */
  session(id: string): BusSession {
    return new BusSession(this.#zenohSession, id, this.#key)
  }
}

/** A session, reached over Zenoh. Refusals are thrown as {@link ProblemError}. */
export class BusSession extends Arrays {
  readonly #zenohSession: ZenohSession
  readonly #attachment: { readonly attachment?: string }

  constructor(
    zenohSession: ZenohSession,
    /** Its identifier. */
    readonly id: string,
    key?: string,
  ) {
    super()
    this.#zenohSession = zenohSession
    this.#attachment = key === undefined ? {} : { attachment: key }
  }

  /** What is known of it now. */
  info(): Promise<SessionInfo> {
    return this.#ask('info')
  }

  /** Makes the next generation. */
  edit(request: EditRequest): Promise<EditReply> {
    return this.#ask('edits', request)
  }

  /** Names candidate pairs, which are then prepared in the background. */
  addSeams(pairs: readonly (readonly [number, number])[]): Promise<Schemas['SeamReply']> {
    return this.#ask('seams', { pairs })
  }

  /** Lets forces act on the running simulation; those that the daemon refuses are lost. */
  pushForces(forces: readonly Force[]): Promise<void> {
    return this.#publish('forces', { forces })
  }

  /** Takes hold of vertices, or moves what holds on; what the daemon refuses is lost. */
  grab(grabs: readonly Grab[], release: readonly number[] = []): Promise<void> {
    return this.#publish('grabs', { grabs, release })
  }

  /** The states that the simulation publishes from now on. */
  async states(): Promise<BusStream<StateFrame>> {
    return BusStream.open(this.#zenohSession, await this.#published('state'), (bytes) =>
      decodeState(bytes.slice().buffer as ArrayBuffer),
    )
  }

  /** Every new generation from now on. */
  async generations(): Promise<BusStream<Schemas['GenerationInfo']>> {
    const key = await this.#published('generation')
    return BusStream.open(this.#zenohSession, key, parse<Schemas['GenerationInfo']>)
  }

  /** Where the daemon publishes: where it asks for keys, apart from other tenants. */
  async #published(resource: string): Promise<string> {
    const { tenant } = this.#attachment.attachment === undefined ? {} : await this.info()
    if (!tenant) {
      return this.#keyOf(resource)
    }
    return `${PREFIX}/tenants/${tenant}/sessions/${this.id}/${resource}`
  }

  override async frame(
    resource: string,
    generation: Generation,
    { dtype }: ArrayOptions<DType> = {},
    query: Record<string, string | number> = {},
  ): Promise<Frame> {
    const asked = Object.entries({ generation, dtype: dtype ?? 'f32', ...query })
    const parameters = asked.map(([name, value]) => `${name}=${value}`).join(';')
    // Frames are read in place, so they begin where a buffer does.
    const bytes = await this.#query(`${resource}?${parameters}`, { priority: PRIORITY.arrays })
    return decodeFrame(bytes.slice())
  }

  async #ask<T>(resource: string, request?: object): Promise<T> {
    const payload = request && { payload: JSON.stringify(request), encoding: JSON_ENCODING }
    return parse<T>(await this.#query(resource, { priority: PRIORITY.small, ...payload }))
  }

  /** Every daemon is asked; those that do not have the session say so (404). */
  async #query(resource: string, options: object): Promise<Uint8Array> {
    const replies = await this.#zenohSession.get(this.#keyOf(resource), {
      timeout: QUERY_TIMEOUT,
      ...options,
      ...this.#attachment,
    })
    let refusal: ProblemError | undefined
    for await (const reply of replies ?? []) {
      const result = reply.result()
      const bytes = result.payload().toBytes()
      if ('keyexpr' in result) return bytes
      if (refusal === undefined || refusal.status === 404) refusal = ProblemError.parse(text(bytes))
    }
    const detail = `nobody answers for ${this.#keyOf(resource)}`
    throw refusal ?? new ProblemError({ type: 'about:blank', title: 'Absent', status: 404, detail })
  }

  #publish(resource: string, document: object): Promise<void> {
    return this.#zenohSession.put(this.#keyOf(resource), JSON.stringify(document), {
      encoding: JSON_ENCODING,
      congestionControl: DROP,
      priority: PRIORITY.hand,
      express: true,
      ...this.#attachment,
    })
  }

  #keyOf(resource: string): string {
    return `${PREFIX}/sessions/${this.id}/${resource}`
  }
}

/** Publications as they arrive: an asynchronous iterable that ends when it is closed. */
export class BusStream<T> extends Arrivals<T> {
  #subscriber: ZenohSubscriber | undefined

  /** Subscribes to `key`. */
  static async open<T>(
    zenohSession: ZenohSession,
    key: string,
    decode: (bytes: Uint8Array) => T,
  ): Promise<BusStream<T>> {
    const stream = new BusStream<T>()
    const handler = (sample: Payload) => stream.receive(() => decode(sample.payload().toBytes()))
    stream.#subscriber = await zenohSession.declareSubscriber(key, { handler })
    return stream
  }

  override close(): void {
    this.#subscriber?.undeclare().catch(() => undefined)
    this.#subscriber = undefined
    this.end()
  }
}

function text(bytes: Uint8Array): string {
  return new TextDecoder().decode(bytes)
}

function parse<T>(bytes: Uint8Array): T {
  return JSON.parse(text(bytes)) as T
}
