/** Requests to one daemon. */

import { ProblemError } from './problem.js'
import type { components } from './schema.js'
import { Session } from './session.js'
import type { SocketConstructor } from './states.js'

type Schemas = components['schemas']
/** What a session is made from. */
export type SessionConfig = Schemas['SessionConfig']
/** What is known of a session. */
export type SessionInfo = Schemas['SessionInfo']
/** One page of sessions. */
export type SessionList = Schemas['SessionList']

/** How to reach a daemon. */
export interface ClientOptions {
  /** The key of `Authorization: Bearer`, where the daemon wants one. */
  readonly key?: string
  /** The WebSocket to use; by default the global one. */
  readonly WebSocket?: SocketConstructor
}

/** What a request asks beside its path. */
export interface RequestOptions {
  readonly method?: 'GET' | 'POST' | 'PUT' | 'DELETE'
  readonly query?: Record<string, string | number | undefined>
  readonly accept?: string
  /** A document, or a form. */
  readonly body?: object
  readonly signal?: AbortSignal | undefined
  /** Whether the request outlives the page that makes it. */
  readonly keepalive?: boolean
}

/** A client of the daemon at one address. */
export class Client {
  readonly #base: string
  readonly #options: ClientOptions

  /** @param base such as `http://127.0.0.1:8080`; nothing is sent yet */
  constructor(base: string, options: ClientOptions = {}) {
    this.#base = base.replace(/\/+$/, '')
    this.#options = options
  }

  /**
   * Opens a session on the mesh inside `config`, or on the files of a mesh (TetGen's are two), whose
   * names' extensions tell the format. Answers as soon as the daemon has accepted it, see {@link Session.waitReady}.
   */
  async create(
    config: SessionConfig,
    ...files: readonly { readonly name: string; readonly content: Blob }[]
  ): Promise<Session> {
    let body: object = config
    if (files.length > 0) {
      const form = new FormData()
      form.append('config', new Blob([JSON.stringify(config)], { type: 'application/json' }))
      for (const { name, content } of files) form.append('mesh', content, name)
      body = form
    }
    const info = await this.document<SessionInfo>('/v1/sessions', { method: 'POST', body })
    return this.session(info.id)
  }

  /** The session named `id`, whether or not it exists. */
  session(id: string): Session {
    return new Session(this, id)
  }

  /** One page of at most `limit` sessions, beginning behind the session `after`. */
  async list(after?: string, limit = 50, signal?: AbortSignal): Promise<SessionList> {
    return this.document<SessionList>('/v1/sessions', { query: { after, limit }, signal })
  }

  /** Every session, page by page. */
  async listAll(signal?: AbortSignal): Promise<SessionInfo[]> {
    const sessions: SessionInfo[] = []
    let after: string | undefined
    do {
      const page = await this.list(after, 50, signal)
      sessions.push(...page.sessions)
      after = page.next ?? undefined
    } while (after !== undefined)
    return sessions
  }

  /** The JSON document that answers a request. */
  async document<T>(path: string, options: RequestOptions = {}): Promise<T> {
    return (await (await this.request(path, options)).json()) as T
  }

  /** The bytes that answer a request. */
  async bytes(path: string, options: RequestOptions = {}): Promise<Uint8Array> {
    return new Uint8Array(await (await this.request(path, options)).arrayBuffer())
  }

  /** The answer to a request, if it is a success; otherwise throws a {@link ProblemError}. */
  async request(path: string, options: RequestOptions = {}): Promise<Response> {
    const { method = 'GET', query = {}, accept, body, signal, keepalive = false } = options
    const given = Object.entries(query).filter(([, value]) => value !== undefined)
    const search = new URLSearchParams(given.map(([name, value]) => [name, String(value)]))
    const headers = new Headers()
    if (accept !== undefined) headers.set('accept', accept)
    if (this.#options.key) headers.set('authorization', `Bearer ${this.#options.key}`)
    const isDocument = body !== undefined && !(body instanceof FormData)
    if (isDocument) headers.set('content-type', 'application/json')
    const response = await fetch(this.#base + path + (given.length > 0 ? `?${search}` : ''), {
      method,
      headers,
      body: isDocument ? JSON.stringify(body) : ((body as FormData | undefined) ?? null),
      signal: signal ?? null,
      keepalive,
    })
    if (!response.ok) throw await ProblemError.of(response)
    return response
  }

  /** The address of a WebSocket, and what makes it. */
  socket(path: string): [url: string, Constructor: SocketConstructor] {
    const Constructor =
      this.#options.WebSocket ??
      (globalThis as { WebSocket?: SocketConstructor }).WebSocket
    if (Constructor === undefined) {
      throw new Error('there is no WebSocket here: pass one to the Client')
    }
    // Browsers send no header of ours with a WebSocket.
    const { key } = this.#options
    const shown = key ? `?access_token=${encodeURIComponent(key)}` : ''
    return [this.#base.replace(/^http/, 'ws') + path + shown, Constructor]
  }
}
