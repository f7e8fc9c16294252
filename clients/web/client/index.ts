/**
 * Client of the sutura daemon, for browsers and Node.
 *
 * ```ts
 * const client = new Client('http://127.0.0.1:8080')
 * const session = await client.create(config, { name: 'organ.msh', content: file })
 * await session.waitReady()
 * const pairs = [[17, 4021], [18, 4022]]
 * const reply = await session.edit({ edits: [{ stitch: { pairs, stiffness_n_m: 1e5 } }] })
 * await session.simulate()
 * const tracker = await Tracker.open(session)
 * for await (const state of session.states()) draw(await tracker.displacement(state))
 * ```
 */

export type { DType, Elements, ElementsOf, NdArray } from './array.js'
export { Arrays } from './arrays.js'
export type { ArrayOptions, Evaluator, Generation, GenerationArray, Stitches } from './arrays.js'
export { BusClient, BusSession, BusStream } from './bus.js'
export type { ZenohReply, ZenohSession, ZenohSubscriber } from './bus.js'
export type { BlockName, Combination } from './combination.js'
export type { SessionEvent } from './events.js'
export { decodeFrame, FRAME_MEDIA_TYPE } from './frame.js'
export type { Frame } from './frame.js'
export { Client } from './http.js'
export type { ClientOptions, RequestOptions, SessionConfig, SessionInfo, SessionList } from './http.js'
export { decodeNpy, NPY_MEDIA_TYPE } from './npy.js'
export { DecodeError, ProblemError } from './problem.js'
export type { Problem } from './problem.js'
export type { components, paths } from './schema.js'
export { Session } from './session.js'
export type {
  Edit,
  EditReply,
  EditRequest,
  Evaluation,
  Force,
  Grab,
  SimulationConfig,
  SimulationInfo,
} from './session.js'
export { decodeState } from './state.js'
export type { StateFrame } from './state.js'
export { Arrivals, StateStream } from './states.js'
export type { Socket, SocketConstructor } from './states.js'
export { boundaryTriangles, coincidentPairs } from './surface.js'
export { combine, Tracker } from './tracker.js'
export type { Shapes, TrackerOptions } from './tracker.js'
