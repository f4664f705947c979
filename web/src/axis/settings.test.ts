import { describe, expect, it } from "vitest";
import { format, parse } from "./settings";

const FILE = `
# feeder
[axis.1]
profile = "tmcm-171"

[axis.1.settings]
"max current" = "1.25 A"   # AP 6
"motor poles" = 8          # AP 253
mode = "torque"
odd = { raw = 120 }
`;

describe("settings files", () => {
  it("are read as polepair config writes them", () => {
    expect(parse(FILE, 1)).toEqual({
      values: { "max current": "1.25 A", "motor poles": 8, mode: "torque" },
      left: ["odd = { raw = 120 }"],
    });
  });

  it("fit a drive of another number if they have one axis only", () => {
    expect(parse(FILE, 7)?.values["motor poles"]).toBe(8);
    expect(parse(`${FILE}\n[axis.2.settings]\n"motor poles" = 4\n`, 7)).toBeNull();
    expect(parse(`${FILE}\n[axis.2.settings]\n"motor poles" = 4\n`, 2)?.values).toEqual({
      "motor poles": 4,
    });
    expect(parse("", 1)).toBeNull();
  });

  it("are read back as they were written", () => {
    const text = format(3, "tmcm-171", [
      { name: "motor poles", value: 8, unit: "", word: null, symbol: "AP 253" },
      { name: "max current", value: 1.25, unit: "A", word: null, symbol: "AP 6" },
      { name: "mode", value: 2, unit: "", word: "torque", symbol: "AP 1" },
    ]);
    expect(text.indexOf("max current")).toBeLessThan(text.indexOf("motor poles"));
    expect(parse(text, 3)?.values).toEqual({
      "max current": "1.25 A",
      mode: "torque",
      "motor poles": 8,
    });
  });
});
