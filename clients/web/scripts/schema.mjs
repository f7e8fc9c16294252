/**
 * Compares `client/schema.ts`, the types of the daemon's documents, with what a daemon describes at
 * `/openapi.json`; with `--write`, makes it anew.
 */

import { readFileSync, writeFileSync } from 'node:fs'
import openapiTypescript, { astToString } from 'openapi-typescript'
import { startDaemon } from './daemon.mjs'

const FILE = new URL('../client/schema.ts', import.meta.url)

const HEADER = `/**
 * The documents and routes of the daemon. Made of its /openapi.json by \`npm run schema\`: not to be
 * edited by hand.
 */

`

/** The file as it should be for the daemon at `address`. */
export async function schemaOf(address) {
  const document = await (await fetch(`${address}/openapi.json`)).json()
  const ast = await openapiTypescript(document, { defaultNonNullable: false })
  return HEADER + astToString(ast)
}

/** The file as it is. */
export function committedSchema() {
  return readFileSync(FILE, 'utf8')
}

if (process.argv[2] === '--write') {
  const daemon = await startDaemon()
  writeFileSync(FILE, await schemaOf(daemon.address))
  await daemon.stop()
}
