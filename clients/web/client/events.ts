/** Server-sent events of a session. Read with `fetch`, which unlike `EventSource` can carry a key. */

import type { components } from './schema.js'

/** One event: `state`, `stage`, `generation`, `simulation`, `failed` or `deleted`. */
export type SessionEvent = components['schemas']['Event']

/** The events in `body`, one after the other, until it ends. */
export async function* decodeEvents(
  body: ReadableStream<Uint8Array>,
): AsyncGenerator<SessionEvent, void, undefined> {
  const reader = body.getReader()
  const utf8 = new TextDecoder()
  let rest = ''
  try {
    for (;;) {
      const { done, value } = await reader.read()
      if (done) return
      const blocks = (rest + utf8.decode(value, { stream: true })).split('\n\n')
      rest = blocks.pop() ?? ''
      for (const block of blocks) {
        const data = block.split('\n').filter((line) => line.startsWith('data:'))
        const text = data.map((line) => line.slice(5).trimStart()).join('\n')
        if (text !== '') yield JSON.parse(text) as SessionEvent
      }
    }
  } finally {
    await reader.cancel().catch(() => undefined)
  }
}
