import { type ChildProcess, spawn } from "node:child_process";
import { once } from "node:events";
import { join } from "node:path";
import type { Browser, Page } from "playwright-core";
import { afterAll, beforeAll, expect, it } from "vitest";
import { pathWith, python, root } from "../support/checkout.js";
import { startChromium } from "../support/chromium.js";
import { keepPicture, serious, usable } from "./support.js";

let serving: ChildProcess;
let browser: Browser;
let page: Page;
let printed = "";
/** Where the second ball is, in pixels of the photographs: left, top, right, bottom. */
let second: Record<string, [number, number, number, number]>;
const complaints: string[] = [];
const photo = { width: 200, height: 150 };

async function print(what: RegExp): Promise<RegExpExecArray> {
  for (let tries = 0; tries < 2400; tries++) {
    const found = what.exec(printed);
    if (found !== null) return found;
    if (serving.exitCode !== null) throw new Error(`the page's server ended: ${printed}`);
    await new Promise((done) => setTimeout(done, 50));
  }
  throw new Error(`never printed ${what}: ${printed}`);
}

beforeAll(async () => {
  serving = spawn(python, [join(root, "tests/support/mask_page.py")], {
    cwd: root,
    env: { ...process.env, PYTHONPATH: pathWith("tests") },
    stdio: ["ignore", "pipe", "inherit"],
  });
  serving.stdout?.on("data", (piece) => {
    printed += piece;
  });
  browser = await startChromium();
  page = await browser.newPage({ viewport: { width: 1100, height: 900 } });
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("console", (message) => {
    if (message.type() === "error") complaints.push(message.text());
  });
  const [, address] = await print(/(http:\S+)/);
  second = JSON.parse(printed.split("\n")[0]!);
  await page.goto(address!);
  await page.waitForSelector(".masks[data-drawn]");
});
afterAll(async () => {
  await browser?.close();
  if (serving.exitCode === null) {
    serving.kill("SIGINT");
    await once(serving, "exit");
  }
});

/** Return which share of the second ball belongs to the object now, by the mask that the page gets. */
function share(frame: string): Promise<number> {
  return page.evaluate(
    async ([name, box]) => {
      const key = new URLSearchParams(location.hash.slice(1)).get("key");
      const mask = await createImageBitmap(await (await fetch(`/edit/${key}/mask?frame=${name}`)).blob());
      const context = new OffscreenCanvas(mask.width, mask.height).getContext("2d")!;
      context.drawImage(mask, 0, 0);
      const [left, top, right, bottom] = box;
      const { data } = context.getImageData(left, top, right - left, bottom - top);
      return data.filter((value, index) => index % 4 === 0 && value >= 128).length / (data.length / 4);
    },
    [frame, second[frame]!] as const,
  );
}

/** Return where a point of the open photograph is on the screen. */
async function onScreen(x: number, y: number): Promise<[number, number]> {
  const box = (await page.locator(".large canvas").boundingBox())!;
  const scale = Math.min(box.width / photo.width, box.height / photo.height);
  return [
    box.x + (box.width - scale * photo.width) / 2 + scale * x,
    box.y + (box.height - scale * photo.height) / 2 + scale * y,
  ];
}

/** Open a photograph and cross the second ball out with the brush. */
async function crossOut(frame: string): Promise<void> {
  await page.click(`.shots button:has-text("${frame}")`);
  await page.waitForSelector(`.large h2:text-is("${frame}")`);
  const [left, top, right, bottom] = second[frame]!;
  await page.mouse.move(...(await onScreen(left + 9, (top + bottom) / 2)));
  await page.mouse.down();
  await page.mouse.move(...(await onScreen((left + right) / 2, (top + bottom) / 2)), { steps: 4 });
  await page.mouse.move(...(await onScreen(right - 9, (top + bottom) / 2)), { steps: 4 });
  await page.mouse.up();
}

const compared = (marks: string) =>
  page.waitForFunction(
    (text) =>
      /photographs compared in/.test(document.querySelector(".masks [role=status]")?.textContent ?? "") &&
      [...document.querySelectorAll(".shots .badge")].filter((each) => /mark/.test(each.textContent))
        .length === Number(text),
    marks,
  );

it("shows every photograph with its mask, usable by all, and fits a phone", async () => {
  expect(await page.locator(".shots button").count()).toBe(12);
  expect(await page.textContent(".masks [role=status]")).toMatch(/^Agreement between the views: \d+%\.$/);
  expect(await share("v10")).toBeGreaterThan(0.7);
  await usable(page);
  await keepPicture(page, "masks-all");
});

it("takes a wrong part out of photographs that nobody has touched", async () => {
  const before = await share("v10");
  await page.click(`.shots button:has-text("v08")`);
  // The brush is as wide as the ball: by keyboard, as by hand.
  await page.locator(".large canvas").focus();
  for (let times = 0; times < 7; times++) await page.keyboard.press("]");
  await crossOut("v08");
  await compared("1");
  await crossOut("v09");
  await compared("2");
  await page.waitForFunction(() => document.querySelector(".masks")?.getAttribute("aria-busy") === "false");
  expect(await share("v10")).toBeLessThan(0.5 * before);
  await usable(page);
  await keepPicture(page, "masks-marked");
});

it("is undone with Ctrl-Z, marked by keyboard and cleared", async () => {
  await page.locator(".large canvas").focus();
  await page.keyboard.press("Control+z");
  await compared("1");
  await page.keyboard.press("x");
  await page.keyboard.press("o");
  await page.keyboard.press(" ");
  for (const key of ["Shift+ArrowRight", "Shift+ArrowDown"]) await page.keyboard.press(key);
  await page.keyboard.press(" ");
  await compared("2");
  await page.click("text=Clear this photograph");
  await compared("1");
  await page.keyboard.press("Control+z");
  await compared("2");
  await page.click("text=Clear this photograph");
  await page.locator(".large canvas").focus();
  await page.keyboard.press("Escape");
  await page.waitForSelector(".large", { state: "hidden" });
  expect(await page.evaluate(() => document.activeElement?.textContent)).toMatch(/^v09/);
});

it("ends with the command that trains, and keeps the corrections", async () => {
  await page.click("button:text-is('Done')");
  await page.waitForSelector("pre:has-text('lambent train photographs -o run')");
  expect(await serious(page)).toEqual([]);
  const [line] = await print(/^\{"done".*$/m);
  const kept = JSON.parse(line!);
  expect(kept.done).toBe(true);
  expect(kept.corrections).toHaveLength(1);
  const { frame, label, stroke, radius } = kept.corrections[0];
  expect([frame, label]).toEqual(["v08", "background"]);
  const [left, top, right, bottom] = second.v08!;
  for (const [x, y] of stroke) {
    expect(x).toBeGreaterThan(left);
    expect(x).toBeLessThan(right);
    expect(y).toBeGreaterThan(top);
    expect(y).toBeLessThan(bottom);
  }
  expect(radius).toBeGreaterThan(2);
  expect(complaints).toEqual([]);
});
