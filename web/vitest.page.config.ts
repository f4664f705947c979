import { defineConfig } from "vitest/config";

// The page in a real browser against the real server: one after the other, with time for both.
export default defineConfig({
  test: {
    include: ["test/**/*.test.ts"],
    environment: "node",
    fileParallelism: false,
    testTimeout: 60_000,
    hookTimeout: 60_000,
  },
});
