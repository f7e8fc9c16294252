import { gzipSync } from 'node:zlib'
import { defineConfig } from 'vite'
import type { Plugin } from 'vite'

/** Puts a compressed copy beside every file that is worth it: the daemon serves both as they are. */
const compressed: Plugin = {
  name: 'compressed',
  apply: 'build',
  generateBundle(_options, bundle) {
    for (const file of Object.values(bundle)) {
      const source = file.type === 'asset' ? file.source : file.code
      if (source.length < 2048) continue
      const gzip = gzipSync(source, { level: 9 })
      this.emitFile({ type: 'asset', fileName: `${file.fileName}.gz`, source: gzip })
    }
  },
}

export default defineConfig({
  root: 'viewer',
  plugins: [compressed],
  build: {
    outDir: '../dist',
    emptyOutDir: true,
    target: 'es2022',
    // Everything comes from the daemon itself, under its content security policy.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
    chunkSizeWarningLimit: 1000,
  },
  server: {
    proxy: { '/v1': { target: process.env['SUTURA_URL'] ?? 'http://127.0.0.1:8080', ws: true } },
  },
})
