/** Opens a session on a mesh file, closes an incision, pulls on a vertex and watches it move. */

import { openAsBlob, readFileSync } from 'node:fs'
import { Client, Tracker } from 'sutura'

const [address, mesh, description] = process.argv.slice(2)
const { domain_materials, fixed_vertices, stitches } = JSON.parse(readFileSync(description))
const config = { domain_materials, fixed_vertices, seams: stitches }
const client = new Client(address)
const session = await client.create(config, { name: mesh, content: await openAsBlob(mesh) })
const { frequencies_hz } = await session.waitReady((event) => console.log(event))
console.log('before:', frequencies_hz.slice(0, 3))

const reply = await session.edit({ edits: [{ stitch: { pairs: stitches, stiffness_n_m: 1e5 } }] })
console.log('after: ', reply.frequencies_hz.slice(0, 3), reply.certificate.verdict)

await session.simulate({ gravity_m_s2: [0, 0, 0] })
const vertex = stitches[0][0]
await session.pushForces([{ vertex, force_n: [0, 0.1, 0], duration_s: 0.2 }])
const tracker = await Tracker.open(session)
for await (const state of session.states()) {
  const displacement = await tracker.displacement(state)
  console.log(state.timeSeconds, displacement.subarray(3 * vertex, 3 * vertex + 3))
  if (state.timeSeconds > 0.5) break
}
await session.delete()
