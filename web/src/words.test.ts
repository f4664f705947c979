import { describe, expect, it } from "vitest";
import { KNOWN, LANGUAGES, say, WORDS } from "./words";

const holes = (text: string): string[] => (text.match(/\{\w+\}/g) ?? []).sort();

describe("words", () => {
  it("are there in each language, with the same parameters", () => {
    for (const [key, texts] of Object.entries({ ...WORDS, ...KNOWN })) {
      expect(texts.length, key).toBe(LANGUAGES.length);
      for (const text of texts) {
        expect(text.trim(), key).toBe(text);
        expect(text, key).not.toBe("");
        expect(holes(text), key).toEqual(holes(texts[0]));
      }
    }
  });

  it("are Chinese in Chinese, except literal input", () => {
    for (const [key, [, chinese]] of Object.entries(WORDS)) {
      if (key !== "filter_example") expect(chinese, key).toMatch(/[\u4e00-\u9fff]/);
    }
  });

  it("take their parameters", () => {
    expect(say("en", "held_by", { owner: "bob" })).toBe("held by bob");
    expect(say("zh", "links_open", { open: 1, all: 2 })).toBe("2 条链路中 1 条已打开");
  });
});
