/** Published states over a WebSocket. */

import { decodeState } from './state.js'
import type { StateFrame } from './state.js'

/** States that wait for a reader that is too slow; beyond, the oldest are dropped. */
const MAX_WAITING = 64

/** The part of a WebSocket that is used here: that of browsers, and of Node from version 22 on. */
export interface Socket {
  binaryType: string
  close(): void
  addEventListener(type: 'message', listener: (event: { data: unknown }) => void): void
  addEventListener(type: 'error' | 'close', listener: () => void): void
}

/** Makes a WebSocket. */
export type SocketConstructor = new (url: string) => Socket

/** States as they arrive: an asynchronous iterable that ends with the connection. */
export class StateStream implements AsyncIterable<StateFrame> {
  readonly #socket: Socket
  readonly #waiting: StateFrame[] = []
  #wake: (() => void) | undefined
  #ended = false
  #error: Error | undefined
  /** States dropped here because nobody took them in time. */
  nDropped = 0

  constructor(url: string, Constructor: SocketConstructor) {
    this.#socket = new Constructor(url)
    this.#socket.binaryType = 'arraybuffer'
    this.#socket.addEventListener('message', ({ data }) => {
      if (data instanceof ArrayBuffer) this.#receive(data)
    })
    this.#socket.addEventListener('error', () => this.#end(new Error(`no stream from ${url.split('?')[0]}`)))
    this.#socket.addEventListener('close', () => this.#end())
  }

  /** Ends the stream; states that wait are still delivered. */
  close(): void {
    this.#socket.close()
    this.#end()
  }

  async *[Symbol.asyncIterator](): AsyncGenerator<StateFrame, void, undefined> {
    try {
      for (;;) {
        const state = this.#waiting.shift()
        if (state !== undefined) {
          yield state
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

  #receive(bytes: ArrayBuffer): void {
    if (this.#ended) return
    try {
      this.#waiting.push(decodeState(bytes))
    } catch (error) {
      this.#end(error as Error)
      this.#socket.close()
      return
    }
    if (this.#waiting.length > MAX_WAITING) {
      this.#waiting.shift()
      this.nDropped += 1
    }
    this.#wake?.()
  }

  #end(error?: Error): void {
    if (!this.#ended) this.#error = error
    this.#ended = true
    this.#wake?.()
  }
}
