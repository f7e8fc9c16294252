/** Published states, as they arrive. */

import { decodeState } from './state.js'
import type { StateFrame } from './state.js'

/** Values that wait for a reader that is too slow; beyond, the oldest are dropped. */
const MAX_WAITING = 64

/** Values as they arrive: an asynchronous iterable that ends with their source. */
export class Arrivals<T> implements AsyncIterable<T> {
  readonly #waiting: T[] = []
  #wake: (() => void) | undefined
  #ended = false
  #error: Error | undefined
  /** Values dropped here because nobody took them in time. */
  nDropped = 0

  /** Ends it; values that wait are still delivered. */
  close(): void {
    this.end()
  }

  async *[Symbol.asyncIterator](): AsyncGenerator<T, void, undefined> {
    try {
      for (;;) {
        const value = this.#waiting.shift()
        if (value !== undefined) {
          yield value
        } else if (this.#ended) {
          if (this.#error) throw this.#error
          return
        } else {
          await new Promise<void>((wake) => (this.#wake = wake))
        }
      }
    } finally {
      this.close()
    }
  }

  /** Takes in what `decode` makes; ends with its error if it throws one. */
  protected receive(decode: () => T): void {
    if (this.#ended) return
    try {
      this.#waiting.push(decode())
    } catch (error) {
      this.end(error as Error)
      this.close()
      return
    }
    if (this.#waiting.length > MAX_WAITING) {
      this.#waiting.shift()
      this.nDropped += 1
    }
    this.#wake?.()
  }

  /** Says that no more will come. */
  protected end(error?: Error): void {
    if (!this.#ended) this.#error = error
    this.#ended = true
    this.#wake?.()
  }
}

/** The part of a WebSocket that is used here: that of browsers, and of Node from version 22 on. */
export interface Socket {
  binaryType: string
  close(): void
  addEventListener(type: 'message', listener: (event: { data: unknown }) => void): void
  addEventListener(type: 'error' | 'close', listener: () => void): void
}

/** Makes a WebSocket. */
export type SocketConstructor = new (url: string) => Socket

/** Published states over a WebSocket. */
export class StateStream extends Arrivals<StateFrame> {
  readonly #socket: Socket

  constructor(url: string, Constructor: SocketConstructor) {
    super()
    this.#socket = new Constructor(url)
    this.#socket.binaryType = 'arraybuffer'
    this.#socket.addEventListener('message', ({ data }) => {
      if (data instanceof ArrayBuffer) this.receive(() => decodeState(data))
    })
    this.#socket.addEventListener('error', () => this.end(new Error(`no stream from ${url.split('?')[0]}`)))
    this.#socket.addEventListener('close', () => this.end())
  }

  override close(): void {
    this.#socket.close()
    this.end()
  }
}
