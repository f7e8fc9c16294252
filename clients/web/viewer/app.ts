/** What the viewer knows and does, without saying how it looks. */

import { Client, ProblemError } from '../client/index.js'
import type {
  Edit,
  EditReply,
  EditRequest,
  SessionConfig,
  SessionEvent,
  SessionInfo,
  SimulationConfig,
} from '../client/index.js'
import { Body, bounds } from './body.js'
import { Signal } from './signal.js'

/** A message for the user. */
export interface Notice {
  readonly kind: 'error' | 'info'
  readonly text: string
}

/** What is being built, and how far it is. */
export interface Progress {
  readonly stage: string
  /** 0 to 1. */
  readonly done: number
}

/** How edits are asked for. */
export interface EditOptions {
  method: NonNullable<EditRequest['method']>
  stiffness: number
  /** In ms; 0 for none. */
  deadline: number
}

/** Which end of a body is held. */
export interface Hold {
  readonly axis: 0 | 1 | 2
  readonly end: 'low' | 'high'
  /** Part of the extent along the axis. */
  readonly fraction: number
}

/** How long after the end of a simulation its states may still arrive, in ms. */
const STRAY_STATES = 500

/** How long to wait before a connection that broke is made again, in ms. */
const RETRY_INTERVAL = 1000

/** How often the list of sessions is asked for, in ms. */
const LIST_INTERVAL = 1500

export class App {
  readonly sessions = new Signal<readonly SessionInfo[]>([])
  readonly selected = new Signal<string | undefined>(undefined)
  readonly info = new Signal<SessionInfo | undefined>(undefined)
  readonly body = new Signal<Body | undefined>(undefined)
  readonly progress = new Signal<Progress | undefined>(undefined)
  readonly isEditing = new Signal(false)
  readonly isSimulating = new Signal(false)
  readonly lastEdit = new Signal<EditReply | undefined>(undefined)
  /** The generation shown. */
  readonly generation = new Signal<number | undefined>(undefined)
  readonly notice = new Signal<Notice | undefined>(undefined)
  readonly needsKey = new Signal(false)
  readonly options: EditOptions = { method: 'flexibility', stiffness: 1e5, deadline: 0 }
  /** Frequencies in Hz of the generations seen. */
  readonly frequencies = new Map<number, readonly number[]>()
  /** Counts changes of `past` and `future`. */
  readonly history = new Signal(0)
  /** Generations to which undo returns, the latest last. */
  past: number[] = []
  /** Those to which redo returns. */
  future: number[] = []

  #client: Client
  #stop = new AbortController()
  #adopting: Promise<void> = Promise.resolve()
  #stoppedAt = -Infinity
  /** What is to be held as soon as a session of this name is ready. */
  readonly #holds = new Map<string, Hold>()

  constructor(private readonly address: string) {
    this.#client = this.#connect(sessionStorage.getItem('sutura-key') ?? '')
  }

  get client(): Client {
    return this.#client
  }

  /** Uses `key` from now on; it is forgotten with the tab. */
  setKey(key: string): void {
    sessionStorage.setItem('sutura-key', key)
    this.#client = this.#connect(key)
    this.needsKey.value = false
    void this.refreshList()
  }

  #connect(key: string): Client {
    return new Client(this.address, key === '' ? {} : { key })
  }

  /** Asks for the sessions again and again, while the page is seen. */
  async watchList(): Promise<never> {
    for (;;) {
      if (!document.hidden && !this.needsKey.value) await this.refreshList()
      await new Promise((wake) => setTimeout(wake, LIST_INTERVAL))
    }
  }

  async refreshList(): Promise<void> {
    try {
      this.sessions.value = await this.#client.listAll()
      this.#notePrepared()
      if (this.notice.value?.text === UNREACHABLE) this.notice.value = undefined
    } catch (error) {
      this.report(error)
    }
  }

  /** Candidate pairs are prepared in the background, unannounced. */
  #notePrepared(): void {
    const [known, body] = [this.info.value, this.body.value]
    const info = this.sessions.value.find((session) => session.id === known?.id)
    if (!info || !known || info.n_prepared_pairs === known.n_prepared_pairs) return
    if (!body || info.generation !== body.current.generation) return
    this.info.value = info
    void this.#prefetch(body)
  }

  /** Says what went wrong. */
  report(error: unknown): void {
    if (error instanceof DOMException && error.name === 'AbortError') return
    this.#noteKey(error)
    const text =
      error instanceof ProblemError
        ? `${error.problem.title}: ${error.problem.detail}`
        : error instanceof TypeError && /fetch|network/i.test(error.message)
          ? UNREACHABLE
          : String((error as Error).message ?? error)
    if (this.notice.value?.text !== text) this.notice.value = { kind: 'error', text }
  }

  /** Opens a session on the files of a mesh. */
  async create(files: readonly File[], config: SessionConfig, hold?: Hold): Promise<void> {
    const session = await this.#client
      .create(config, ...files.map((file) => ({ name: file.name, content: file })))
      .catch((error: unknown) => {
        this.#noteKey(error)
        throw error
      })
    if (hold) this.#holds.set(session.id, hold)
    await this.refreshList()
    this.select(session.id)
  }

  async delete(id: string): Promise<void> {
    try {
      await this.#client.session(id).delete()
      if (this.selected.value === id) this.select(undefined)
    } catch (error) {
      this.report(error)
    }
    await this.refreshList()
  }

  async fork(id: string): Promise<void> {
    try {
      const name = this.sessions.value.find((session) => session.id === id)?.name
      const fork = await this.#client.session(id).fork(name ? `${name}, fork`.slice(0, 200) : undefined)
      await this.refreshList()
      this.select(fork.id)
    } catch (error) {
      this.report(error)
    }
  }

  #noteKey(error: unknown): void {
    if (error instanceof ProblemError && error.status === 401) this.needsKey.value = true
  }

  /** Shows a session, or none. */
  select(id: string | undefined): void {
    if (id === this.selected.value) return
    this.#stop.abort()
    this.#stop = new AbortController()
    this.selected.value = id
    this.info.value = this.sessions.value.find((session) => session.id === id)
    this.body.value = undefined
    this.generation.value = undefined
    this.progress.value = undefined
    this.lastEdit.value = undefined
    this.isSimulating.value = false
    this.frequencies.clear()
    this.past = []
    this.future = []
    this.history.value += 1
    this.notice.value = undefined
    if (id !== undefined) void this.#watch(id, this.#stop.signal)
  }

  /** Follows a session until another is selected. */
  async #watch(id: string, signal: AbortSignal): Promise<void> {
    while (!signal.aborted) {
      try {
        const session = this.#client.session(id)
        this.info.value = await session.info(signal)
        for await (const event of session.events(signal)) await this.#hear(id, event, signal)
      } catch (error) {
        if (signal.aborted) return
        const isGone = error instanceof ProblemError && error.status === 404
        if (isGone) this.select(undefined)
        this.report(error)
        if (isGone) return
      }
      await new Promise((wake) => setTimeout(wake, RETRY_INTERVAL))
    }
  }

  async #hear(id: string, event: SessionEvent, signal: AbortSignal): Promise<void> {
    if (signal.aborted) return
    switch (event.event) {
      case 'stage':
        this.progress.value = { stage: event.stage, done: event.progress }
        break
      case 'state':
        if (event.state === 'ready') this.progress.value = undefined
        this.info.value = await this.#client.session(id).info(signal)
        if (event.state === 'ready' || event.state === 'rebuilding') await this.#open(id, signal)
        break
      case 'generation':
        if (this.body.value) await this.#adopt(event.generation, !this.isEditing.value)
        break
      case 'simulation':
        if (!event.running) this.#stoppedAt = performance.now()
        this.isSimulating.value = event.running
        break
      case 'failed':
        this.progress.value = undefined
        this.info.value = await this.#client.session(id).info(signal)
        break
      case 'deleted':
        this.select(undefined)
        this.notice.value = { kind: 'info', text: 'The session was deleted.' }
    }
  }

  /** Fetches the body of a session that has become ready. */
  async #open(id: string, signal: AbortSignal): Promise<void> {
    if (this.body.value) return
    const body = await Body.open(this.#client.session(id))
    if (signal.aborted) return
    this.frequencies.set(body.current.generation, this.info.value?.frequencies_hz ?? [])
    await this.#recall(body, signal)
    if (signal.aborted) return
    this.body.value = body
    this.generation.value = body.current.generation
    const hold = this.#holds.get(id)
    this.#holds.delete(id)
    if (hold) void this.edit([{ fix: { vertices: this.heldBy(hold) } }])
    else void this.#prefetch(body)
  }

  /** Learns what the daemon still has of earlier generations: what was before an edit, and what can be
   * returned to, outlives the page. */
  async #recall(body: Body, signal: AbortSignal): Promise<void> {
    const { generation } = body.current
    const oldest = (await body.session.info(signal)).oldest_generation ?? generation
    const kept = Array.from({ length: Math.max(0, generation - oldest) }, (_, i) => oldest + i)
    try {
      await Promise.all(
        kept.map(async (earlier) => {
          this.frequencies.set(earlier, Array.from(await body.session.frequencies(earlier, signal)))
        }),
      )
    } catch (error) {
      // One was dropped meanwhile, for an edit that somebody made: there is nothing to return to then.
      if (error instanceof ProblemError && error.status === 404) return
      throw error
    }
    this.past = kept
    this.history.value += 1
  }

  /** Shows `generation`; `isForeign` if nobody here asked for it. */
  #adopt(generation: number, isForeign: boolean): Promise<void> {
    const [body, signal] = [this.body.value, this.#stop.signal]
    const turn = this.#adopting.then(async () => {
      if (!body || signal.aborted || body.current.generation >= generation) return
      const before = body.current.generation
      await body.follow(generation)
      const info = await body.session.info(signal)
      if (signal.aborted) return
      this.frequencies.set(generation, info.frequencies_hz)
      const isFinished = this.lastEdit.value?.certificate.is_unfinished === true
      if (isForeign && !isFinished) {
        this.past.push(before)
        this.future = []
        this.lastEdit.value = undefined
        this.history.value += 1
      }
      this.info.value = info
      this.generation.value = generation
      void this.#prefetch(body)
    })
    this.#adopting = turn.catch((error: unknown) => this.report(error))
    return this.#adopting
  }

  /** Fetches what further edits will be combined of, while nothing else is going on. */
  async #prefetch(body: Body): Promise<void> {
    try {
      if (body.pairs.length > 0) await body.tracker.prefetch()
    } catch {
      // The next edit fetches what it needs.
    }
  }

  /** Makes the next generation, from `restore` if that is given. */
  async edit(edits: Edit[], restore?: number): Promise<EditReply | undefined> {
    const body = this.body.value
    if (!body || this.isEditing.value) return undefined
    const signal = this.#stop.signal
    this.isEditing.value = true
    this.notice.value = undefined
    const before = body.current.generation
    try {
      const { method, deadline } = this.options
      const isFlexible = method === 'flexibility'
      const reply = await body.session.edit(
        {
          base_generation: before,
          edits,
          method,
          ...(restore === undefined ? {} : { restore }),
          ...(isFlexible && deadline > 0 ? { deadline_ms: deadline } : {}),
        },
        signal,
      )
      if (restore === undefined) {
        this.past.push(before)
        this.future = []
        this.history.value += 1
      }
      this.lastEdit.value = reply
      await this.#adopt(reply.generation, false)
      return reply
    } catch (error) {
      if (!signal.aborted) this.report(error)
      return undefined
    } finally {
      this.isEditing.value = false
      this.progress.value = undefined
    }
  }

  /** Stitches candidate pairs, by their places in the body's list. */
  async stitch(places: readonly number[]): Promise<void> {
    const body = this.body.value
    if (!body) return
    const stitched = body.stitchedPairs()
    const pairs = places
      .filter((place) => !stitched.has(place))
      .map((place): [number, number] => [body.pairs[2 * place]!, body.pairs[2 * place + 1]!])
    if (pairs.length === 0) return
    await this.edit([{ stitch: { pairs, stiffness_n_m: this.options.stiffness } }])
  }

  /** Removes the stitches of candidate pairs. */
  async unstitch(places: readonly number[]): Promise<void> {
    const body = this.body.value
    if (!body) return
    const stitched = body.stitchedPairs()
    const ids = places.map((place) => stitched.get(place)).filter((id) => id !== undefined)
    if (ids.length > 0) await this.edit([{ unstitch: { stitch_ids: ids } }])
  }

  get canUndo(): boolean {
    return this.past.length > 0
  }

  get canRedo(): boolean {
    return this.future.length > 0
  }

  async undo(): Promise<void> {
    await this.#return(this.past, this.future)
  }

  async redo(): Promise<void> {
    await this.#return(this.future, this.past)
  }

  /** Returns to the last of `from`; what is current becomes the last of `to`. */
  async #return(from: number[], to: number[]): Promise<void> {
    const [target, current] = [from.at(-1), this.generation.value]
    if (target === undefined || current === undefined || this.isEditing.value) return
    const reply = await this.edit([], target)
    if (reply === undefined) return
    from.pop()
    to.push(current)
    this.history.value += 1
  }

  /** Names all candidate pairs, so that edits of them take no solve. */
  async prepareSeams(): Promise<void> {
    const body = this.body.value
    if (!body) return
    const pairs = Array.from(body.pairs.subarray(0, body.pairs.length / 2), (_, i) => i)
    try {
      await body.session.addSeams(pairs.map((i) => [body.pairs[2 * i]!, body.pairs[2 * i + 1]!]))
      await this.refreshList()
    } catch (error) {
      this.report(error)
    }
  }

  /** The vertices at one end of the body. */
  heldBy({ axis, end, fraction }: Hold): number[] {
    const positions = this.body.value?.current.positions ?? new Float32Array()
    const { low, high } = bounds(positions)
    const depth = fraction * (high[axis] - low[axis])
    const held = []
    for (let vertex = 0; vertex < positions.length / 3; vertex++) {
      const x = positions[3 * vertex + axis]!
      if (end === 'low' ? x <= low[axis] + depth : x >= high[axis] - depth) held.push(vertex)
    }
    return held
  }

  /** Starts the simulation, or changes it. */
  async simulate(config: SimulationConfig): Promise<boolean> {
    const body = this.body.value
    if (!body) return false
    try {
      await body.session.simulate({ dt_s: 0.005, publish_hz: 60, ...config })
      this.isSimulating.value = true
      return true
    } catch (error) {
      this.report(error)
      return false
    }
  }

  /** A state of the session has arrived: somebody simulates it, unless that is the last one. */
  noteState(): void {
    if (performance.now() - this.#stoppedAt > STRAY_STATES) this.isSimulating.value = true
  }

  async stopSimulation(): Promise<void> {
    this.#stoppedAt = performance.now()
    try {
      await this.body.value?.session.stopSimulation()
    } catch (error) {
      this.report(error)
    }
    this.isSimulating.value = false
  }
}

const UNREACHABLE = 'The daemon does not answer. Is it still running?'
