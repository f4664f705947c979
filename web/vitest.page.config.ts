import { defineConfig } from "vitest/config";

// The page in a real browser against the real server: two at a time, with time for both.
export default defineConfig({
  test: {
    include: ["test/**/*.test.ts"],
    environment: "node",
    maxWorkers: 2,
    // Long enough time-outs for a machine that is busy with other things.
    env: { POLEPAIR_TIMEOUT_SCALE: "10" },
    testTimeout: 240_000,
    hookTimeout: 240_000,
  },
});
