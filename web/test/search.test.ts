// A drive on a port of unknown protocol and rate: it is searched for, and shown with its connection string.

import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { afterAll, afterEach, beforeAll, describe, expect, it } from "vitest";
import { Visitor } from "./browser";
import { Drive } from "./server";

const SEARCH_MS = 240_000;

// Most attempts meet silence: the server need not wait for them as long as elsewhere.
process.env.POLEPAIR_TIMEOUT_SCALE = "2";

let v: Visitor;
let folder: string;
let port: string;
let drive: Drive;

beforeAll(async () => {
  folder = mkdtempSync(join(tmpdir(), "polepair-search-"));
  port = join(folder, "servo");
  drive = await Drive.start("modbus-rtu:1", "--pty", port);
  v = await Visitor.come("--search-port", port, "sim:tmcl");
  await v.page.goto(v.server.url);
  await v.card(0).waitFor();
});
afterAll(async () => {
  await v?.leave();
  await drive?.takeAway();
  rmSync(folder, { recursive: true, force: true });
});
afterEach(() => v.content());

describe("searching a port", () => {
  const group = () => v.page.getByRole("group", { name: "Search ports for drives" });

  it("refuses a name that is no port of the machine", async () => {
    await group().getByRole("textbox").fill("/etc/passwd");
    await group().getByRole("button", { name: "Search" }).click();
    await v.until(
      () => group().getByRole("alert").innerText(),
      (text) => text.includes("is not a port of this machine"),
    );
    // The refusal is an answer too, and a browser writes those of 404 down.
    v.complaints = v.complaints.filter((each) => !each.includes("404"));
  });

  it("is cancelled", async () => {
    await group().getByRole("textbox").fill(port);
    await group().getByRole("button", { name: "Search" }).click();
    await group().getByRole("progressbar").waitFor();
    await group().getByRole("button", { name: "Cancel" }).click();
    await v.until(
      () => group().getByRole("status").innerText(),
      (text) => text.startsWith("Cancelled before the end."),
    );
  });

  it("finds the drive, and shows its connection string", { timeout: SEARCH_MS }, async () => {
    await group().getByRole("button", { name: "Search" }).click();
    await v.until(
      () => group().getByRole("status").innerText(),
      (text) => text === "Drives found: 1",
      SEARCH_MS,
    );
    const text = await group().innerText();
    const url = `modbus-rtu+serial://${port}:115200#1`;
    expect(text).toContain("SYNTRON TS");
    expect(text).toContain(`polepair serve "${url}"`);
    await v.picture("search");
  });

  it("has no serious findings of axe", { timeout: SEARCH_MS }, async () => {
    expect(await v.serious()).toEqual([]);
  });
});
