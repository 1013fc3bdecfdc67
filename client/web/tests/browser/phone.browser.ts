import type { CDPSession, Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { change, drawnIn, openViewer, soon, stateOf } from "./support.js";

const [width, height] = [390, 844];
const browser = await sharedChromium();
let page: Page;
let session: CDPSession;

/** Return where something of the viewer is on the screen. */
const boxOf = (selector: string) =>
  page.evaluate((name) => {
    const found = document.querySelector("lambent-viewer")!.shadowRoot!.querySelector(name)!;
    const { left, top, right, bottom } = found.getBoundingClientRect();
    return { left, top, right, bottom };
  }, selector);
const isOpen = () =>
  page.evaluate(
    () =>
      document.querySelector("lambent-viewer")!.shadowRoot!.querySelector<HTMLDetailsElement>(".panel")!.open,
  );
const middle = () =>
  page.evaluate(() => {
    const viewer = document.querySelector("lambent-viewer")!.viewer!;
    const { clientWidth, clientHeight } = viewer.canvas;
    const { centreX, centreY } = viewer.canvasCamera({ width: clientWidth, height: clientHeight });
    return [centreX, centreY];
  });

/** Move one finger upwards along the screen. */
async function slide(from: number, up: number, steps = 12): Promise<void> {
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", y: number | null) =>
    session.send("Input.dispatchTouchEvent", {
      type,
      touchPoints: y === null ? [] : [{ x: width / 2, y, id: 0 }],
    });
  await touch("touchStart", from);
  for (let step = 1; step <= steps; step++) await touch("touchMove", from - (up * step) / steps);
  // Held for a moment, so that where it is counts, not how fast it went.
  await page.waitForTimeout(60);
  await touch("touchMove", from - up);
  await touch("touchEnd", null);
}

type Point = readonly [x: number, y: number];

/** Put fingers down, move each of them along its way in steps, and lift them. */
async function fingers(way: (share: number) => readonly Point[], steps = 5): Promise<void> {
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", points: readonly Point[]) =>
    session.send("Input.dispatchTouchEvent", {
      type,
      touchPoints: points.map(([x, y], id) => ({ x, y, id })),
    });
  await touch("touchStart", way(0));
  for (let step = 1; step <= steps; step++) await touch("touchMove", way(step / steps));
  await touch("touchEnd", []);
}
const state = () => stateOf(page);
const update = (part: object) => change(page, part);
/** Wait until nothing is drawn for three seconds. */
const rest = () => expect.poll(() => drawnIn(page, 3000), { timeout: 90_000 }).toBe(0);

beforeAll(async () => {
  const context = await browser.newContext({
    ...{ viewport: { width, height }, hasTouch: true, isMobile: true, reducedMotion: "reduce" },
    locale: "en-US",
  });
  page = await openViewer(context, { env: "preset:studio", rotate: "0,0,0" });
  session = await context.newCDPSession(page);
});

describe("on a phone", () => {
  it("lights and the ball are in sight, and the object is in the middle of the rest", async () => {
    expect(await isOpen()).toBe(false);
    const [row, ball, bar] = [await boxOf(".chips"), await boxOf(".ball"), await boxOf(".panel")];
    for (const { left, top, right, bottom } of [row, ball, bar]) {
      expect([left >= 0, top >= 0, right <= width, bottom <= height]).toEqual([true, true, true, true]);
    }
    expect(row.top).toBeGreaterThan(0.75 * height);
    expect(row.right).toBeLessThanOrEqual(ball.left);
    expect(Math.max(row.bottom, ball.bottom)).toBeLessThanOrEqual(bar.top);
    const [x, y] = await middle();
    expect(x).toBe(width / 2);
    expect(Math.abs(y! - 0.5 * Math.min(row.top, ball.top))).toBeLessThan(8);
  });

  it("the sheet opens and closes with a tap, and leaves room for the object", async () => {
    const bar = await boxOf(".panel > summary");
    await page.touchscreen.tap(100, 0.5 * (bar.top + bar.bottom));
    await soon(isOpen).toBe(true);
    const panel = await boxOf(".panel");
    expect(panel.bottom - panel.top).toBeLessThanOrEqual(0.451 * height);
    const row = await boxOf(".chips");
    expect(row.bottom).toBeLessThanOrEqual(panel.top);
    expect(row.top).toBeGreaterThan(0.35 * height);
    await soon(async () => (await middle())[1]! / row.top).toBeCloseTo(0.5, 1);
    const summary = await boxOf(".panel > summary");
    await page.touchscreen.tap(100, 0.5 * (summary.top + summary.bottom));
    await soon(isOpen).toBe(false);
  });

  it("the sheet is dragged open and shut, and falls back where that was too little", async () => {
    const from = async (): Promise<number> => {
      const { top, bottom } = await boxOf(".panel > summary");
      return 0.5 * (top + bottom);
    };
    await slide(await from(), 40);
    await soon(isOpen).toBe(false);
    await slide(await from(), 320);
    await soon(isOpen).toBe(true);
    await slide(await from(), -320);
    await soon(isOpen).toBe(false);
  });

  it("everything that is touched is 44 pixels high and wide at least", async () => {
    await page.evaluate(() => {
      for (const part of document.querySelector("lambent-viewer")!.shadowRoot!.querySelectorAll("details")) {
        part.open = true;
      }
    });
    const small = await page.evaluate(() =>
      [
        ...document
          .querySelector("lambent-viewer")!
          .shadowRoot!.querySelectorAll<HTMLElement>("button, select, input, summary, .ball, .handle"),
      ]
        .filter((each) => each.offsetParent !== null)
        // A box with its words beside it is touched on them, too.
        .map((each) => (each.matches("[type=checkbox]") ? each.closest("label")! : each))
        .filter((each) => each.offsetHeight < 44 || each.offsetWidth < 44)
        .map((each) => `${each.outerHTML.slice(0, 80)} ${each.offsetWidth} x ${each.offsetHeight}`),
    );
    expect(small).toEqual([]);
    await page.evaluate(() => {
      document
        .querySelector("lambent-viewer")!
        .shadowRoot!.querySelector<HTMLDetailsElement>(".panel")!.open = false;
    });
  });

  it("nothing is drawn while nothing changes, with the sheet open or shut", async () => {
    await rest();
    const bar = await boxOf(".panel > summary");
    await page.touchscreen.tap(100, 0.5 * (bar.top + bar.bottom));
    await soon(isOpen).toBe(true);
    await rest();
  });

  it("a tap on a light chooses it, and the row is swiped to the others", async () => {
    await page.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      root.querySelector<HTMLDetailsElement>(".panel")!.open = false;
    });
    const row = page.locator(".chips");
    const scrolled = () => row.evaluate((element) => element.scrollLeft);
    await page.getByRole("button", { name: "Clear sky" }).tap();
    await soon(async () => (await state()).environment).toBe("preset:sky");
    await row.evaluate((element) => element.scrollTo(0, 0));
    const { left, right, top, bottom } = await boxOf(".chips");
    // From the picture of a light, too.
    const y = top + 0.35 * (bottom - top);
    await fingers((share) => [[right - 20 - share * (right - left - 60), y]]);
    await soon(scrolled).toBeGreaterThan(50);
    await page.getByRole("button", { name: "Low sun" }).tap();
    await soon(async () => (await state()).environment).toBe("preset:sunset");
    await update({ environment: "preset:studio" });
  });

  it("a finger on the ball turns the light, and on the picture the camera", async () => {
    const before = await state();
    const ball = await boxOf(".ball");
    const [x, y] = [0.5 * (ball.left + ball.right), 0.5 * (ball.top + ball.bottom)];
    await fingers((share) => [[x - 16 * share, y]]);
    const lit = await state();
    expect(Math.abs(lit.turn.yawDeg - before.turn.yawDeg)).toBeGreaterThan(20);
    expect(lit.pose).toEqual(before.pose);
    await update({ turn: before.turn });
    await fingers((share) => [[140 + 80 * share, 300]]);
    const turned = await state();
    expect(turned.pose.azimuthDeg).toBeLessThan(before.pose.azimuthDeg - 15);
    expect(turned.turn).toEqual(before.turn);
    await update({ pose: before.pose });
    // Nothing of the page scrolls meanwhile.
    await fingers((share) => [[195, 200 + 120 * share]]);
    expect(await page.evaluate(() => [scrollX, scrollY, visualViewport!.scale])).toEqual([0, 0, 1]);
    expect((await state()).pose.elevationDeg).not.toBeCloseTo(before.pose.elevationDeg, 0);
    await update({ pose: before.pose });
  });

  it("two fingers zoom as they part, and turn the light as they turn", async () => {
    const before = await state();
    await fingers((share) => [
      [175 - 45 * share, 300],
      [215 + 45 * share, 300],
    ]);
    const near = await state();
    expect(near.pose.distance).toBeLessThan(0.8 * before.pose.distance);
    expect(near.turn).toEqual(before.turn);
    expect(await page.evaluate(() => visualViewport!.scale)).toBe(1);
    await update({ pose: before.pose });
    await fingers((share) => {
      const angle = (40 * share * Math.PI) / 180;
      const [dx, dy] = [60 * Math.cos(angle), 60 * Math.sin(angle)];
      return [
        [195 - dx, 300 - dy],
        [195 + dx, 300 + dy],
      ];
    });
    const after = await state();
    expect(after.turn.yawDeg).toBeLessThan(before.turn.yawDeg - 28);
    expect(Math.abs(after.pose.distance / before.pose.distance - 1)).toBeLessThan(0.05);
    await update({ turn: before.turn, pose: before.pose });
  });
});

describe.each(["en-US", "de-DE"])("on a desk, in the language of %s", (locale) => {
  it("no choice is longer than its field", async () => {
    const context = await browser.newContext({ locale, viewport: { width: 1280, height: 800 } });
    const desk = await openViewer(context, { env: "preset:studio", rotate: "0,0,0" });
    const long = await desk.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      for (const part of root.querySelectorAll("details")) part.open = true;
      const context = new OffscreenCanvas(1, 1).getContext("2d")!;
      return [...root.querySelectorAll("select")].flatMap((list) => {
        // Some are shown in certain states only; without a box nothing has a width.
        list.parentElement!.hidden = false;
        const style = getComputedStyle(list);
        context.font = style.font;
        // The arrow takes as much as two letters.
        const room = list.clientWidth - Number.parseFloat(style.paddingLeft) - 22;
        return [...list.options]
          .map(({ text }) => text)
          .filter((text) => !text.includes(".exr") && context.measureText(text).width > room);
      });
    });
    expect(long).toEqual([]);
    await context.close();
  });
});
