import type { Browser, BrowserContext, CDPSession, Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { sharedChromium } from "../support/chromium.js";
import { change, drawnIn, fixedView, openViewer, soon, stateOf } from "./support.js";

const size = { width: 480, height: 360 };
const browser = await sharedChromium();
let page: Page;

const state = (of = page) => stateOf(of);
const update = (part: object, of = page) => change(of, part);
const rest = (of = page) => soon(() => drawnIn(of, 1500)).toBe(0);

async function open(more: Parameters<Browser["newContext"]>[0] = {}): Promise<[BrowserContext, Page]> {
  const context = await browser.newContext({ viewport: size, ...more });
  return [context, await openViewer(context, { ...fixedView, env: "preset:studio" })];
}

beforeAll(async () => {
  [, page] = await open({ reducedMotion: "reduce" });
});

describe("the camera", () => {
  it("turns when someone drags, and with the arrow keys", async () => {
    const before = await state();
    await page.mouse.move(100, 180);
    await page.mouse.down();
    await page.mouse.move(140, 200);
    await page.mouse.up();
    const dragged = await state();
    // Seven tenths of a turn over the height of the picture.
    expect(dragged.pose.azimuthDeg).toBeCloseTo(before.pose.azimuthDeg - 28, 3);
    expect(dragged.pose.elevationDeg).toBeCloseTo(before.pose.elevationDeg + 14, 3);
    await page.keyboard.press("ArrowLeft");
    expect((await state()).pose.azimuthDeg).toBeCloseTo(dragged.pose.azimuthDeg - 5, 6);
    // The hand continues where the keys have left it.
    await page.mouse.move(100, 180);
    await page.mouse.down();
    await page.mouse.move(110, 180);
    await page.mouse.up();
    expect((await state()).pose.azimuthDeg).toBeCloseTo(dragged.pose.azimuthDeg - 12, 3);
    await update({ pose: before.pose });
  });

  it("stays near where photographs were taken, or anywhere if that is asked for, and within reach", async () => {
    const before = await state();
    const pull = async (): Promise<number> => {
      for (let times = 0; times < 3; times++) {
        await page.mouse.move(100, 80);
        await page.mouse.down();
        await page.mouse.move(100, 230, { steps: 3 });
        await page.mouse.up();
      }
      return (await state()).pose.elevationDeg;
    };
    const [, highest] = await page.evaluate(
      () => document.querySelector("lambent-viewer")!.viewer!.elevationRange,
    );
    expect(highest).toBeLessThan(60);
    expect(await pull()).toBeCloseTo(highest!, 3);
    await update({ free: true });
    expect(await pull()).toBeCloseTo(89, 3);
    // What is outside, as a link may have it, does not jump.
    await update({ free: false });
    expect(await pull()).toBeCloseTo(89, 3);
    await page.mouse.move(150, 120);
    await page.mouse.wheel(0, 9000);
    await soon(async () => (await state()).pose.distance).toBeCloseTo(20, 3);
    await update({ pose: before.pose });
  });

  it("comes nearer with the wheel, and moves with Ctrl or the right button", async () => {
    const before = await state();
    await page.mouse.move(150, 150);
    await page.mouse.wheel(0, -200);
    await soon(async () => (await state()).pose.distance).toBeCloseTo(3.2 * Math.exp(-0.24), 3);
    await page.keyboard.down("Control");
    await page.mouse.down();
    await page.mouse.move(170, 150);
    await page.mouse.up();
    await page.keyboard.up("Control");
    const moved = await state();
    expect(moved.pose.azimuthDeg).toBeCloseTo(before.pose.azimuthDeg, 6);
    expect(Math.hypot(...moved.pose.target)).toBeGreaterThan(0.05);
    await page.mouse.down({ button: "right" });
    await page.mouse.move(150, 150);
    await page.mouse.up({ button: "right" });
    expect(Math.hypot(...(await state()).pose.target)).toBeLessThan(0.005);
    await update({ pose: before.pose });
  });

  it("stays where it is while Shift turns the light", async () => {
    const before = await state();
    await page.keyboard.down("Shift");
    await page.mouse.move(100, 180);
    await page.mouse.down();
    await page.mouse.move(120, 180);
    await page.mouse.up();
    await page.keyboard.up("Shift");
    const after = await state();
    expect(after.pose).toEqual(before.pose);
    expect(after.turn.yawDeg).toBeCloseTo(before.turn.yawDeg + 7, 6);
  });

  it("and the light stay where they are once something took the pointer away", async () => {
    await page.keyboard.down("Shift");
    await page.mouse.move(100, 180);
    await page.mouse.down();
    await page.mouse.move(110, 180);
    const canvas = page.locator("canvas[role=application]");
    await canvas.evaluate((element: HTMLElement) => element.releasePointerCapture(1));
    const lit = await state();
    await page.mouse.move(160, 180);
    expect((await state()).turn).toEqual(lit.turn);
    await page.mouse.up();
    await page.keyboard.up("Shift");
    await page.mouse.down();
    await page.mouse.move(180, 180);
    await canvas.dispatchEvent("pointercancel", { pointerId: 1, pointerType: "mouse", bubbles: true });
    const turned = await state();
    expect(turned.pose.azimuthDeg).not.toBeCloseTo(lit.pose.azimuthDeg, 1);
    await page.mouse.move(240, 180);
    expect((await state()).pose).toEqual(turned.pose);
    await page.mouse.up();
    await update({ pose: lit.pose });
    await rest();
  });

  it("looks at the point of the surface that is clicked twice, from nearer, and nowhere else", async () => {
    const before = await state();
    await page.mouse.dblclick(20, 200);
    expect(await state()).toEqual(before);
    const [x, y] = await page.evaluate(() => {
      const viewer = document.querySelector("lambent-viewer")!.viewer!;
      const { centreX, centreY } = viewer.canvasCamera();
      return [centreX - 10, centreY + 15];
    });
    await page.mouse.dblclick(x!, y!);
    await soon(async () => (await state()).pose.distance).toBeCloseTo(0.6 * 3.2, 2);
    const { pose } = await state();
    expect(pose.target).not.toEqual([0, 0, 0]);
    expect(Math.max(...pose.target.map(Math.abs))).toBeLessThan(1);
    expect(pose.azimuthDeg).toBeCloseTo(before.pose.azimuthDeg, 6);
    // What was clicked is in the middle now.
    await page.mouse.dblclick(x! + 10, y! - 15);
    await soon(async () => (await state()).pose.distance).toBeCloseTo(0.36 * 3.2, 2);
    expect(
      Math.hypot(...(await state()).pose.target.map((value, axis) => value - pose.target[axis]!)),
    ).toBeLessThan(0.02);
    await update({ pose: before.pose });
  });

  it("draws nothing while nothing moves, also while it is held", async () => {
    await rest();
    expect(await drawnIn(page, 1500)).toBe(0);
    await page.mouse.move(100, 180);
    await page.mouse.down();
    await page.mouse.move(104, 180);
    await rest();
    await page.mouse.up();
    await rest();
  });
});

describe("a camera with inertia", () => {
  it("continues for a moment, comes to rest, and is undone in one step", async () => {
    const [context, moving] = await open();
    const before = await state(moving);
    await moving.mouse.move(100, 180);
    await moving.mouse.down();
    await moving.mouse.move(160, 180, { steps: 4 });
    const held = await state(moving);
    await moving.mouse.up();
    await rest(moving);
    const after = await state(moving);
    expect(after.pose.azimuthDeg).toBeCloseTo(before.pose.azimuthDeg - 42, 1);
    expect(held.pose.azimuthDeg).toBeGreaterThan(after.pose.azimuthDeg);
    await moving.keyboard.press("Control+z");
    expect(await state(moving)).toEqual(before);
    await rest(moving);
    expect(await state(moving)).toEqual(before);
    await context.close();
  });
});

describe("fingers", () => {
  let touched: Page;
  let session: CDPSession;
  const touch = (type: "touchStart" | "touchMove" | "touchEnd", ...points: [number, number][]) =>
    session.send("Input.dispatchTouchEvent", {
      type,
      touchPoints: points.map(([x, y], id) => ({ x, y, id })),
    });

  beforeAll(async () => {
    const [context, opened] = await open({ hasTouch: true, reducedMotion: "reduce" });
    touched = opened;
    session = await context.newCDPSession(touched);
  });

  it("turn the camera, one at a time", async () => {
    const before = await state(touched);
    await touch("touchStart", [100, 180]);
    await touch("touchMove", [120, 180]);
    await touch("touchMove", [140, 180]);
    await touch("touchEnd");
    expect((await state(touched)).pose.azimuthDeg).toBeLessThan(before.pose.azimuthDeg - 15);
    await update({ pose: before.pose }, touched);
  });

  it("pinch", async () => {
    const before = await state(touched);
    await touch("touchStart", [140, 150], [180, 150]);
    for (let step = 1; step <= 5; step++)
      await touch("touchMove", [140 - 8 * step, 150], [180 + 8 * step, 150]);
    await touch("touchEnd");
    const after = await state(touched);
    expect(after.pose.distance).toBeLessThan(0.8 * before.pose.distance);
    expect(after.turn).toEqual(before.turn);
    await update({ pose: before.pose }, touched);
  });

  it("turn the light by turning two of them, as it is seen from above", async () => {
    const before = await state(touched);
    const at = (degrees: number): [[number, number], [number, number]] => {
      const [x, y] = [50 * Math.cos((degrees * Math.PI) / 180), 50 * Math.sin((degrees * Math.PI) / 180)];
      return [
        [160 - x, 150 - y],
        [160 + x, 150 + y],
      ];
    };
    await touch("touchStart", ...at(0));
    for (let step = 1; step <= 10; step++) await touch("touchMove", ...at(4 * step));
    await touch("touchEnd");
    const after = await state(touched);
    // Less what is needed to tell it from a pinch.
    expect(after.turn.yawDeg).toBeLessThan(before.turn.yawDeg - 28);
    expect(after.turn.yawDeg).toBeGreaterThan(before.turn.yawDeg - 41);
    expect(Math.abs(after.pose.distance / before.pose.distance - 1)).toBeLessThan(0.05);
  });
});
