import { describe, expect, it } from "vitest";
import { fieldAt, split } from "./bytes";

describe("bytes of a frame", () => {
  it("are found on serial lines and on CAN", () => {
    expect(split("01 04 ff")).toEqual({ id: "", bytes: ["01", "04", "ff"] });
    expect(split("0104FF")).toEqual({ id: "", bytes: ["01", "04", "FF"] });
    expect(split("30B#5443")).toEqual({ id: "30B", bytes: ["54", "43"] });
    expect(split("123#")).toEqual({ id: "123", bytes: [] });
  });

  it("belong to the narrowest field around them", () => {
    const field = (from: number, to: number) => ({ from, to, name: "", value: "", meaning: "" });
    const fields = [field(0, 4), field(1, 2), field(2, 2)];
    expect([0, 1, 2, 3, 4].map((byte) => fieldAt(fields, byte))).toEqual([0, 1, 0, 0, -1]);
  });
});
