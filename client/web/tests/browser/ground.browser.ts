import type { Page } from "playwright-core";
import { beforeAll, describe, expect, it } from "vitest";
import { directionOfPixel, type Direction } from "../../src/engine/environment.js";
import { rotateAboutZ } from "../lookup.js";
import { type EnvironmentMap, pixelSolidAngle } from "../../src/engine/environmentMap.js";
import { readExr } from "../../src/light/exrInput.js";
import { sharedChromium } from "../support/chromium.js";
import { fixedView, fixtureFile, keep, meanDifference, openViewer, pictureOf } from "./support.js";

/** The boxes of tests/support/viewer_fixture.py; the ground is under the first. */
const boxes = [
  [
    [-1, -1, -0.6],
    [1, 1, -0.4],
  ],
  [
    [-0.7, -0.5, -0.4],
    [0, 0.3, 0.5],
  ],
  [
    [0.3, -0.3, -0.4],
    [0.8, 0.6, 0.1],
  ],
] as const;
const groundZ = -0.6;
const points = [
  [1.15, 0],
  [0, -1.15],
  [-1.3, 0.3],
  [1.2, 1.2],
  [-1.2, -1.4],
  [0.4, 1.6],
  [2, -0.5],
] as const;

/** A camera above the middle that looks down; x is to the right, y up. */
const side = 256;
const focal = 330;
const above = {
  ...{ width: side, height: side, focalX: focal, focalY: focal, centreX: side / 2, centreY: side / 2 },
  cameraToWorld: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 6, 0, 0, 0, 1],
};

const browser = await sharedChromium();
let page: Page;

beforeAll(async () => {
  page = await openViewer(browser, {
    ...fixedView,
    env: "preset:even",
    background: "transparent",
    ground: "1",
  });
});

/** Whether a ray from the ground meets a box. */
function hidden(x: number, y: number, direction: Direction): boolean {
  const origin = [x, y, groundZ];
  return boxes.some(([low, high]) => {
    let [first, last] = [1e-6, Number.POSITIVE_INFINITY];
    for (const axis of [0, 1, 2] as const) {
      const [a, b] = [low[axis], high[axis]].map((plane) => (plane - origin[axis]!) / direction[axis]);
      first = Math.max(first, Math.min(a!, b!));
      last = Math.min(last, Math.max(a!, b!));
    }
    return first < last;
  });
}

/** Return the share of luminance that the boxes keep from a point of the ground, summed over a map's pixels. */
function sharesKept(map: EnvironmentMap, yawDeg: number): number[] {
  const [kept, whole] = [points.map(() => 0), points.map(() => 0)];
  for (let row = 0; row < map.height / 2; row++) {
    for (let column = 0; column < map.width; column++) {
      const direction = rotateAboutZ(directionOfPixel(row, column, map.height, map.width), yawDeg);
      const start = 3 * (row * map.width + column);
      const [red, green, blue] = map.radianceRgb.slice(start, start + 3);
      const light =
        pixelSolidAngle(row, map.height, map.width) *
        direction[2] *
        (0.2126 * red! + 0.7152 * green! + 0.0722 * blue!);
      points.forEach(([x, y], index) => {
        whole[index]! += light;
        if (hidden(x, y, direction)) kept[index]! += light;
      });
    }
  }
  return kept.map((value, index) => value / whole[index]!);
}

/** Return the alpha of the points in a picture from above. */
function alphas(picture: Uint8Array): number[] {
  return points.map(([x, y]) => {
    const scale = focal / (6 - groundZ);
    const [column, row] = [Math.floor(side / 2 + scale * x), Math.floor(side / 2 - scale * y)];
    return picture[4 * (row * side + column) + 3]! / 255;
  });
}

async function show(change: object): Promise<Uint8Array> {
  await page.evaluate((given) => document.querySelector("lambent-viewer")!.update(given), change);
  return pictureOf(page, above);
}

describe("the shadow on the ground", () => {
  it("covers as much as the object hides of an even sky", async () => {
    const even: EnvironmentMap = {
      height: 64,
      width: 128,
      radianceRgb: new Float32Array(3 * 64 * 128).fill(1),
    };
    const found = alphas(await show({ environment: "preset:even" }));
    const expected = sharesKept(even, 0);
    expect(Math.max(...expected)).toBeGreaterThan(0.2);
    found.forEach((alpha, index) => {
      expect(Math.abs(alpha - expected[index]!)).toBeLessThan(0.025);
    });
  });

  it.each([0, 90])("is that of a sun and coloured walls, turned by %i degrees", async (yawDeg) => {
    const map = await readExr(Uint8Array.from(fixtureFile("spots.exr")), 1 << 20);
    const turn = { yawDeg, pitchDeg: 0, rollDeg: 0, intensity: 1 };
    const picture = await show({ environment: "url:data/spots.exr", turn });
    keep(`ground_${yawDeg}`, picture, side);
    const found = alphas(picture);
    const expected = sharesKept(map, yawDeg);
    expect(Math.max(...expected) - Math.min(...expected)).toBeGreaterThan(0.2);
    const errors = found.map((alpha, index) => Math.abs(alpha - expected[index]!));
    expect(Math.max(...errors)).toBeLessThan(0.1);
    expect(errors.reduce((sum, error) => sum + error, 0) / errors.length).toBeLessThan(0.03);
  });

  it("darkens what is behind where something is, and is in saved radiance", async () => {
    const { look, turn } = await page.evaluate(() => document.querySelector("lambent-viewer")!.state);
    const environment = "preset:sky";
    const plain = await show({ environment, turn: { ...turn, yawDeg: 0 }, look: { ...look, ground: false } });
    const clear = await show({ look: { ...look, background: "colour", ground: false } });
    const shaded = await show({ look: { ...look, background: "colour", ground: true } });
    const shadow = await show({ look: { ...look, ground: true } });
    alphas(plain).forEach((alpha) => {
      expect(alpha).toBe(0);
    });
    for (let pixel = 0; pixel < shaded.length; pixel += 4) {
      // Nothing becomes brighter, the object stays as it is, and where alpha rises the colour falls.
      expect(shaded[pixel]!).toBeLessThanOrEqual(clear[pixel]! + 1);
      if (plain[pixel + 3] === 255) expect(shaded[pixel]).toBe(clear[pixel]);
      if (shadow[pixel + 3]! > 60 && plain[pixel + 3] === 0)
        expect(shaded[pixel]!).toBeLessThan(clear[pixel]!);
    }
    const half = await page.evaluate(() => [
      ...document.querySelector("lambent-viewer")!.viewer!.radiance(32, 24, 1),
    ]);
    const one = 0x3c00;
    expect(half.filter((value, index) => index % 4 === 3 && value > 0 && value < one).length).toBeGreaterThan(
      10,
    );
    await show({ look: { ...look, ground: true } });
  });

  it("is left out of other channels, of plain image-based light, and from below", async () => {
    const state = await page.evaluate(() => document.querySelector("lambent-viewer")!.state);
    for (const channel of ["indirect", "albedo"]) {
      const found = alphas(await show({ look: { ...state.look, channel } }));
      expect(Math.max(...found)).toBe(0);
    }
    const plain = await show({ look: state.look, compare: "plain", split: 0 });
    expect(Math.max(...alphas(plain))).toBe(0);
    await show({ compare: "off", split: 0.5, pose: { ...state.pose, elevationDeg: -30 } });
    const below = await pictureOf(page, { width: 96, height: 72 });
    await show({ look: { ...state.look, ground: false } });
    expect(meanDifference(below, await pictureOf(page, { width: 96, height: 72 }))).toBe(0);
  });
});

describe("the shadow on the ground while something moves", () => {
  it("becomes darker from frame to frame, and is whole at rest", async () => {
    const own = await openViewer(
      browser,
      { ...fixedView, env: "preset:even", background: "colour", ground: "1" },
      null,
      {
        width: 320,
        height: 240,
      },
    );
    const { means, rest } = await own.evaluate(async () => {
      const element = document.querySelector("lambent-viewer")!;
      const viewer = element.viewer!;
      viewer.moving = true;
      await element.show("data/bundle/");
      viewer.dither = false;
      const meanOf = (data: Uint8ClampedArray): number =>
        data.reduce((sum, value) => sum + value, 0) / data.length;
      const shown = (): number => {
        const { canvas } = viewer;
        const context = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d")!;
        context.drawImage(canvas, 0, 0);
        return meanOf(context.getImageData(0, 0, canvas.width, canvas.height).data);
      };
      const found: number[] = [];
      for (let frame = 0; frame < 17; frame++) {
        viewer.drawNow(1);
        found.push(shown());
      }
      viewer.drawNow(2);
      return { means: found, rest: shown() };
    });
    for (let frame = 1; frame < means.length; frame++) {
      expect(means[frame]!).toBeLessThanOrEqual(means[frame - 1]! + 0.01);
    }
    expect(means[0]! - means.at(-1)!).toBeGreaterThan(0.3);
    expect(Math.abs(means.at(-1)! - rest)).toBeLessThan(0.2);
    await own.close();
  });
});
