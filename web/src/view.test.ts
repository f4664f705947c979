import { describe, expect, it } from "vitest";
import { blank, parse, write } from "./view";

describe("the view in the URL", () => {
  it("is read back as it was written", () => {
    const view = {
      ...blank(),
      axis: 3,
      upper: "tuning" as const,
      span: 0.5,
      hz: 1000,
      when: "rising" as const,
      level: -1.5,
      once: true,
      filter: "axis = 2 and not ok",
      channels: [
        { axis: 0, signal: "position" },
        { axis: 12, signal: "target velocity" },
      ],
    };
    expect(parse(`#${write(view)}`)).toEqual(view);
  });

  it("omits defaults, and falls back to them for invalid parts", () => {
    expect(write(blank())).toBe("");
    expect(parse("")).toEqual(blank());
    expect(parse("#axis=-1&span=7&hz=nan&when=x&ch=<b>,1.,x.position&level=1e999")).toEqual(
      blank(),
    );
  });

  it("takes sixteen channels at most", () => {
    const many = Array.from({ length: 40 }, (_, i) => `${i}.position`).join(",");
    expect(parse(`ch=${many}`).channels.length).toBe(16);
  });
});
