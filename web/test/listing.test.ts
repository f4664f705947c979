// The program in a module: its listing, and the instruction that runs.

import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";
import { Drive, polepair } from "./server";

const TEXT = `
Loop:   MVP REL, 0, 200
        WAIT POS, 0, 0
        CSUB Count
        WAIT TICKS, 0, 40
        JA Loop
Count:  GGP 1, 2
        CALC ADD, 1
        AGP 1, 2
        RSUB
`;

let drive: Drive;
let v: Visitor;
const folder = mkdtempSync(join(tmpdir(), "polepair-listing-"));

beforeAll(async () => {
  drive = await Drive.start("tmcm-1140:1");
  const file = join(folder, "count.tmc");
  writeFileSync(file, TEXT);
  polepair("program", "load", drive.url, file);
  polepair("program", "run", drive.url, "--detach");
  v = await Visitor.come(drive.url);
  await v.page.goto(v.server.url);
  await v.card(0).waitFor();
});
afterAll(async () => {
  await v?.leave();
  await drive?.takeAway();
  rmSync(folder, { recursive: true, force: true });
});

describe("a program in a module", () => {
  const list = () => v.page.getByRole("list", { name: "Program in the module" });
  const lines = () => list().getByRole("listitem");

  it("is listed with labels, and the line that runs is marked", async () => {
    await v.page.getByText("Program in the module").click();
    await lines().nth(10).waitFor();
    const texts = (await lines().allInnerTexts()).map((text) => text.replace(/\s+/g, " ").trim());
    expect(texts).toEqual([
      "L0:",
      "0 MVP REL, 0, 200",
      "1 WAIT POS, 0, 0",
      "2 CSUB L5",
      "3 WAIT TICKS, 0, 40",
      "4 JA L0",
      "L5:",
      "5 GGP 1, 2",
      "6 CALC ADD, 1",
      "7 AGP 1, 2",
      "8 RSUB",
    ]);
    const now = list().locator("[aria-current=step]");
    await now.waitFor();
    const marked = new Set<string>();
    await v.until(
      async () => marked.add(await now.innerText()),
      (seen) => seen.size > 1,
    );
    await v.page.getByText(/runs, at \d+/).waitFor();
    await v.picture("program");
    expect(await v.serious()).toEqual([]);
  });

  it("stops with all axes, and the listing shows it", async () => {
    await v.button(/STOP ALL/).click();
    await v.page.getByText(/stopped, at \d+/).waitFor();
  });
});
