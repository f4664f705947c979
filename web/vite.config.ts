import { svelte } from "@sveltejs/vite-plugin-svelte";
import { defineConfig } from "vitest/config";

// The page's CSP allows nothing but files of its own server: no inlined assets, no inline preload.
export default defineConfig({
  plugins: [svelte()],
  build: {
    // Part of the server's crate: a packaged crate contains it.
    outDir: "../crates/serve/page",
    emptyOutDir: true,
    target: "es2022",
    assetsInlineLimit: 0,
    modulePreload: false,
    sourcemap: false,
    chunkSizeWarningLimit: 300,
  },
  test: { include: ["src/**/*.test.ts"], environment: "node" },
});
