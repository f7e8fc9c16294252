/** Errors: RFC 9457 problem documents of the daemon, and bytes that are not what they should be. */

import type { components } from './schema.js'

/** The daemon's problem document. */
export type Problem = components['schemas']['Problem']

/** An answer of the daemon that is not the one asked for. */
export class ProblemError extends Error {
  override readonly name = 'ProblemError'

  /**
   * @param problem the document, or one made up for an answer that carries none
   * @param retryAfterSeconds when to try again, if the daemon said so
   */
  constructor(
    readonly problem: Problem,
    readonly retryAfterSeconds?: number,
  ) {
    const at = problem.instance_pointer ? ` [at ${problem.instance_pointer}]` : ''
    super(`${problem.title} (${problem.status}): ${problem.detail}${at}`)
  }

  /** HTTP status. */
  get status(): number {
    return this.problem.status
  }

  /** The problem of an unsuccessful `response`. */
  static async of(response: Response): Promise<ProblemError> {
    const retryAfter = Number(response.headers.get('retry-after') ?? Number.NaN)
    const text = await response.text()
    return new ProblemError(
      parseProblem(response, text),
      Number.isFinite(retryAfter) ? retryAfter : undefined,
    )
  }

  /** The problem that a text carries, of an answer that came some other way than by HTTP. */
  static parse(text: string): ProblemError {
    let document: unknown
    try {
      document = JSON.parse(text)
    } catch {
      document = undefined
    }
    if (isProblem(document)) return new ProblemError(document)
    const detail = text.slice(0, 200) || 'no explanation was given'
    return new ProblemError({ type: 'about:blank', title: 'Unexpected answer', status: 500, detail })
  }
}

/** Bytes from the daemon that cannot be read. */
export class DecodeError extends Error {
  override readonly name = 'DecodeError'
}

function parseProblem(response: Response, text: string): Problem {
  if (response.headers.get('content-type')?.startsWith('application/problem+json')) {
    const document: unknown = JSON.parse(text)
    if (isProblem(document)) return document
  }
  const detail = text.slice(0, 200) || response.statusText || 'no explanation was given'
  return { type: 'about:blank', title: 'Unexpected answer', status: response.status, detail }
}

function isProblem(document: unknown): document is Problem {
  if (typeof document !== 'object' || document === null) return false
  const { type, title, status, detail } = document as Record<string, unknown>
  const texts = [type, title, detail]
  return texts.every((text) => typeof text === 'string') && typeof status === 'number'
}
