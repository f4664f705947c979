import { defineConfig } from "vitest/config";

// The page in a real browser against the real server: one after the other, with time for both.
export default defineConfig({
  test: {
    include: ["test/**/*.test.ts"],
    environment: "node",
    fileParallelism: false,
    // Long enough time-outs for a machine that is busy with other things.
    env: { POLEPAIR_TIMEOUT_SCALE: "10" },
    testTimeout: 240_000,
    hookTimeout: 240_000,
  },
});
