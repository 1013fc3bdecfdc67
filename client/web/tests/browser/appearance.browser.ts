import { execFileSync } from "node:child_process";
import { readdirSync } from "node:fs";
import { resolve } from "node:path";
import type { BrowserContext, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, inject, it } from "vitest";
import { answerAs, type World } from "../support/cannedServer.js";
import { python } from "../support/checkout.js";
import { sharedChromium } from "../support/chromium.js";
import { GoldenPictures, taken } from "../support/goldenPictures.js";

const sizes = {
  desk: { width: 1280, height: 800 },
  tablet: { width: 834, height: 1112 },
  phone: { width: 390, height: 844 },
} as const;
type SizeName = keyof typeof sizes;

const browser = await sharedChromium();
let pictures: GoldenPictures;

beforeAll(async () => {
  pictures = await GoldenPictures.open(browser);
});
afterAll(async () => {
  await Promise.all(browser.contexts().map((context) => context.close()));
});

/** Return a context in which pages look the same whenever and wherever they are opened. */
function contextOf(size: SizeName, colorScheme: "light" | "dark" = "light"): Promise<BrowserContext> {
  return browser.newContext({
    ...{ viewport: sizes[size], locale: "en-US", timezoneId: "UTC", reducedMotion: "reduce", colorScheme },
    ...(size === "phone" ? { isMobile: true, hasTouch: true } : {}),
  });
}

/** Wait until everything that a page shows has come: its pictures, and what it draws itself. */
async function settled(page: Page): Promise<void> {
  await page.evaluate(async () => {
    const lazy = [...document.querySelectorAll<HTMLImageElement>("img[src]")];
    for (const image of lazy) image.loading = "eager";
    // What is below the window is not drawn before it is near.
    for (const card of document.querySelectorAll<HTMLElement>(".card"))
      card.style.contentVisibility = "visible";
    await Promise.all(lazy.map((image) => image.decode().catch(() => {})));
    scrollTo(0, 0);
    for (const { viewer } of document.querySelectorAll("lambent-viewer")) {
      if (viewer?.bundle == null) continue;
      // As at rest; and wait for the graphics card.
      viewer.drawNow(2);
      const gl = viewer.canvas.getContext("webgl2")!;
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    }
    await new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)));
  });
}

/** A page of ours in a state. */
type State = {
  readonly name: string;
  readonly world: World;
  /** Its address on the site. */
  readonly at: string;
  /** What shows that everything has come. */
  readonly ready: string;
  /** Brings it into the state. */
  readonly act?: (page: Page) => Promise<unknown>;
};

const live = "#connection:text-is('live')";
const states: readonly State[] = [
  { name: "locked", world: "locked", at: "jobs.html", ready: "h1:text-is('Log in')" },
  {
    name: "locked-refused",
    world: "locked",
    at: "jobs.html",
    ready: "h1:text-is('Log in')",
    act: async (page) => {
      await page.fill("#link", "http://127.0.0.1:8000/#code=used-before");
      await page.click("button:text-is('Log in')");
      await page.waitForSelector("text=was used before");
    },
  },
  { name: "start-empty", world: "empty", at: "jobs.html#/", ready: "text=None yet." },
  { name: "start", world: "full", at: "jobs.html#/", ready: "text=Walking boots" },
  {
    name: "start-nothing-found",
    world: "full",
    at: "jobs.html#/?q=teapot",
    ready: "text=No job matches.",
  },
  {
    name: "uploading",
    world: "full",
    at: "jobs.html#/",
    ready: "text=Walking boots",
    act: async (page) => {
      const file = (name: string) => ({ name, mimeType: "image/jpeg", buffer: Buffer.alloc(200_000, name) });
      await page.setInputFiles("input[multiple]", [file("1.jpg"), file("2.jpg")]);
      await page.waitForSelector("text=sending files that the server does not have");
    },
  },
  {
    name: "deleted",
    world: "full",
    at: "jobs.html#/jobs/job_4",
    ready: "text=Delete the job",
    act: async (page) => {
      await page.click("button:text-is('Delete the job')");
      await page.waitForSelector(".toast");
      await page.waitForSelector("text=Walking boots");
    },
  },
  { name: "scene", world: "full", at: "jobs.html#/scenes/scene_5", ready: ".presets label >> nth=3" },
  { name: "scene-unusable", world: "full", at: "jobs.html#/scenes/scene_3", ready: ".findings li" },
  { name: "scene-unfinished", world: "full", at: "jobs.html#/scenes/scene_1", ready: ".drop" },
  { name: "masks", world: "full", at: "jobs.html#/scenes/scene_5/masks", ready: ".shots li >> nth=11" },
  {
    name: "masks-one",
    world: "full",
    at: "jobs.html#/scenes/scene_5/masks",
    ready: ".shots li >> nth=11",
    act: async (page) => {
      await page.click(".shots button >> nth=2");
      await page.waitForSelector(".large:not([hidden]) canvas");
      await page.waitForTimeout(300);
    },
  },
  { name: "job-queued", world: "full", at: "jobs.html#/jobs/job_6", ready: "h1 .state" },
  { name: "job-running", world: "full", at: "jobs.html#/jobs/job_5", ready: ".previews img.on" },
  {
    name: "job-failed",
    world: "full",
    at: "jobs.html#/jobs/job_4",
    ready: ".notice.bad",
    act: async (page) => {
      await page.click("summary:text-is('Log')");
      await page.waitForSelector("pre:has-text('joint')");
    },
  },
  {
    name: "job-done",
    world: "full",
    at: "jobs.html#/jobs/job_3",
    ready: "#figures dd",
    act: async (page) => {
      for (const title of ["Share a link", "All files", "Figures", "How it went"]) {
        const fold = page.locator(`summary:has-text("${title}")`);
        if ((await fold.count()) > 0) await fold.first().click();
      }
      await page.waitForSelector(".shares li");
      await page.locator(".viewer").scrollIntoViewIfNeeded();
      await page.waitForSelector(".viewer lambent-viewer:not(.arriving)");
      const turn = { yawDeg: 0, pitchDeg: 0, rollDeg: 0, intensity: 1 };
      await page.evaluate((given) => document.querySelector("lambent-viewer")!.update({ turn: given }), turn);
    },
  },
  { name: "masks-cut-off", world: "full", at: "masks.html", ready: "#message:not([hidden])" },
  { name: "embed-ended", world: "locked", at: "shared.html#secret", ready: "[role=alert]" },
  { name: "no-such-page", world: "locked", at: "no-such-page", ready: "h1" },
];

/** Return the page that our server sends with status 404, with its headers. */
function notFound(): { body: string; headers: Record<string, string> } {
  const program = `
import json, lambent_pages
page = lambent_pages.not_found()
print(json.dumps({"body": page.content.decode(), "headers": page.headers}))`;
  const printed = execFileSync(python, ["-c", program], { encoding: "utf8" });
  return JSON.parse(printed) as { body: string; headers: Record<string, string> };
}

/** Open a page of ours in a state. */
async function openState(context: BrowserContext, { world, at, ready, act }: State): Promise<Page> {
  const page = await context.newPage();
  await answerAs(page, world);
  await page.route("**/no-such-page", (route) => route.fulfill({ status: 404, ...notFound() }));
  await page.goto(`${inject("site")}/${at}`);
  await page.waitForSelector(ready);
  if (at.startsWith("jobs.html") && world !== "locked") await page.waitForSelector(live);
  await act?.(page);
  await settled(page);
  return page;
}

/** Open the viewer's page in a context, with what is behind an address of the site. */
async function openViewer(context: BrowserContext, src: string | null, held?: Held): Promise<Page> {
  const page = await context.newPage();
  await answerAs(page, "full");
  if (held !== undefined) await page.route("**/data/bundle/**", held);
  const state = { env: "preset:studio", rotate: "0,0,0" };
  const hash = new URLSearchParams(src === null ? state : { ...state, src: `${inject("site")}/${src}` });
  await page.goto(`${inject("site")}/viewer.html#${hash}`);
  return page;
}
type Held = Parameters<Page["route"]>[1];

/** Wait until the viewer has drawn its picture and its lights, and draws no more. */
async function drawn(page: Page): Promise<void> {
  await page.evaluate(() => document.querySelector("lambent-viewer")!.ready);
  const chipsAreDrawn = (): boolean => {
    const chips = document.querySelector("lambent-viewer")!.shadowRoot!.querySelectorAll(".chip canvas");
    return [...chips].every((each) => {
      const { width, height } = each as HTMLCanvasElement;
      const context = (each as HTMLCanvasElement).getContext("2d")!;
      return context.getImageData(width / 2, height / 2, 1, 1).data[3]! > 0;
    });
  };
  // In software, beside other tests, lights take longer than the usual 30 s.
  await page.waitForFunction(chipsAreDrawn, undefined, { timeout: 120_000 });
  await page.evaluate(async () => {
    const viewer = document.querySelector("lambent-viewer")!.viewer!;
    let last = performance.now();
    const stop = viewer.on("draw", () => {
      last = performance.now();
    });
    while (performance.now() - last < 300) await new Promise((resolve) => setTimeout(resolve, 50));
    stop();
  });
}

/** Press a button of the viewer, also one in a part that is closed. */
const press = (page: Page, text: string) =>
  page.evaluate((wanted) => {
    const root = document.querySelector("lambent-viewer")!.shadowRoot!;
    const found = [...root.querySelectorAll("button")].find((each) => each.textContent === wanted);
    if (found === undefined) throw new Error(`there is no button ${wanted}`);
    found.click();
  }, text);
const update = (page: Page, change: object) =>
  page.evaluate((given) => document.querySelector("lambent-viewer")!.update(given), change);
const drag = (page: Page, type: string) =>
  page.evaluate((name) => {
    document.querySelector("lambent-viewer")!.dispatchEvent(new DragEvent(name, { cancelable: true }));
  }, type);
const opened = (page: Page, selector: string, open: boolean) =>
  page.evaluate(
    ([wanted, on]) => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      root.querySelector<HTMLDetailsElement>(wanted)!.open = on;
    },
    [selector, open] as const,
  );

describe.each(Object.keys(sizes) as SizeName[])("on a %s", (size) => {
  let context: BrowserContext;
  beforeAll(async () => {
    context = await contextOf(size);
  });
  afterAll(() => context.close());

  it.each(states.map((state) => [state.name, state] as const))("%s looks as ever", async (name, state) => {
    const page = await openState(context, state);
    const wrong = await pictures.compare(`${name}.${size}`, page);
    await page.close();
    expect(wrong).toEqual([]);
  });

  it("the viewer looks as ever before there is a bundle", async () => {
    const wrong: string[] = [];
    const look = async (name: string, page: Page, ready: string): Promise<void> => {
      await page.waitForSelector(ready);
      await settled(page);
      // How large the bundle is depends on what compressed its files.
      await page.locator(".bytes:text-matches(' of ')").evaluateAll((lines) => {
        for (const line of lines) line.textContent = "0 B of 2.0 MiB";
      });
      wrong.push(...(await pictures.compare(`viewer-${name}.${size}`, page, { whole: false })));
      await page.close();
    };
    await look("welcome", await openViewer(context, null), ".welcome h1");
    const wait: Held = (route) =>
      route.request().url().endsWith("manifest.json") ? route.continue() : undefined;
    await look("loading", await openViewer(context, "data/bundle/", wait), ".bytes:text-matches(' of ')");
    const fail: Held = (route) =>
      route.request().url().endsWith(".glb") ? route.fulfill({ status: 404 }) : route.continue();
    await look("failed", await openViewer(context, "data/bundle/", fail), "[data-problem]");
    expect(wrong).toEqual([]);
  });

  it("the viewer looks as ever with a bundle", { timeout: 400_000 }, async () => {
    const page = await openViewer(context, "v1/bundles/bundle_1");
    const wrong: string[] = [];
    const look = async (name: string): Promise<void> => {
      await drawn(page);
      if (name !== "share") {
        await page.evaluate(() => {
          document.querySelector("lambent-viewer")!.shadowRoot!.querySelector(".panel")!.scrollTop = 0;
        });
      }
      wrong.push(...(await pictures.compare(`viewer-${name}.${size}`, page, { whole: false })));
    };
    await look("bundle");
    const { isOpen } = await page.evaluate(() => {
      const root = document.querySelector("lambent-viewer")!.shadowRoot!;
      return { isOpen: root.querySelector<HTMLDetailsElement>(".panel")!.open };
    });
    await opened(page, ".panel", !isOpen);
    await look(isOpen ? "panel-closed" : "panel-open");
    // Nobody drags files on a phone.
    if (size !== "phone") {
      await drag(page, "dragover");
      await look("dropping");
      await drag(page, "dragleave");
    }
    await opened(page, ".panel", true);
    await page.click("summary:text-is('Share')");
    await page.waitForSelector(".shares li");
    await page.locator(".shares li").scrollIntoViewIfNeeded();
    await look("share");
    await page.click("summary:text-is('Share')");
    await press(page, "+Add a light");
    await look("adding");
    await page.keyboard.press("Escape");
    await update(page, { compare: "environment", environmentB: "preset:even", split: 0.5 });
    await look("compare");
    await update(page, { compare: "off" });
    await press(page, "Make a film…");
    await page.waitForSelector("dialog[open] option:has-text('MP4 (')", { state: "attached" });
    await look("film");
    await page.keyboard.press("Escape");
    // The picture is never made: what the dialog says while it is would depend on the machine.
    await page.route("**/assets/refineWorker*", () => {});
    await update(page, { refine: true });
    await press(page, "Save PNG");
    await page.waitForSelector("dialog[open] >> text=Refining");
    await look("still");
    await page.close();
    expect(wrong).toEqual([]);
  });
});

it("the pages of jobs look as ever in dark colours", async () => {
  const context = await contextOf("desk", "dark");
  const wrong: string[] = [];
  for (const state of states.filter(({ name }) => ["start", "scene", "job-done"].includes(name))) {
    const page = await openState(context, state);
    wrong.push(...(await pictures.compare(`${state.name}.dark`, page)));
    await page.close();
  }
  await context.close();
  expect(wrong).toEqual([]);
});

describe("the comparison", () => {
  const startState = states.find(({ name }) => name === "start")!;
  let context: BrowserContext;
  let page: Page;
  beforeAll(async () => {
    context = await contextOf("desk");
    page = await openState(context, startState);
  });
  afterAll(() => context.close());

  /** Return how the page differs while one of its elements has another style. */
  async function differs(selector: string, name: string, value: string): Promise<string[]> {
    const style = (to: string) =>
      page
        .locator(selector)
        .first()
        .evaluate((element: HTMLElement, [key, text]) => element.style.setProperty(key, text), [
          name,
          to,
        ] as const);
    await style(value);
    const wrong = await pictures.against("start.desk", await taken(page, true));
    await style("");
    return wrong;
  }

  it.each([
    ["a panel that is 8 pixels aside", ".drop", "translate", "8px"],
    ["a panel that is 8 pixels lower", ".drop", "translate", "0 8px"],
    ["a card that is 8 pixels aside", "ol[aria-label=Jobs] .card", "translate", "8px"],
    ["a picture that is missing", "ol[aria-label=Jobs] img:not([hidden])", "visibility", "hidden"],
    ["a title that is missing", "h2", "visibility", "hidden"],
    ["a title in another size", "h1", "font-size", "1.4rem"],
    ["a button in another colour", "button.first", "background-color", "#7a5a30"],
  ] as const)("notices %s", async (_, selector, name, value) => {
    expect(await differs(selector, name, value)).not.toEqual([]);
    // It is about that alone.
    expect(await pictures.against("start.desk", await taken(page, true))).toEqual([]);
  });
});

it("every golden picture is one of these", () => {
  const golden = readdirSync(resolve(import.meta.dirname, "../golden")).map((name) =>
    name.replace(".webp", ""),
  );
  expect(golden.filter((name) => !pictures.seen.has(name))).toEqual([]);
});
