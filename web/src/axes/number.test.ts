import { expect, test } from "vitest";

import { axisNumber } from "./number";

test("an axis is written as in connection strings", () => {
  const shown = [1, 255, 0x2_0005, 0x8000_0000, 0x8000_0001, 0x8000_0005].map(axisNumber);
  expect(shown).toEqual(["1", "255", "5.2", "g*", "g1", "g1+3"]);
});
