import type { Browser, BrowserContext, Page } from "playwright-core";
import { afterAll, beforeAll, describe, expect, it } from "vitest";
import { startChromium } from "../support/chromium.js";
import { JobServer } from "./server.js";
import { choose, folderOf, keepPicture, live, serious, usable } from "./support.js";

const capture = { "transforms_train.json": "{}", "train/1.png": "one", "train/2.png": "two" };

let server: JobServer;
let browser: Browser;
let context: BrowserContext;
let page: Page;
const complaints: string[] = [];

beforeAll(async () => {
  server = new JobServer(true);
  [browser] = await Promise.all([startChromium(), server.start()]);
  context = await browser.newContext({ viewport: { width: 1100, height: 800 } });
  page = await context.newPage();
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("console", (message) => {
    if (message.type() === "error") complaints.push(message.text());
  });
  await page.goto(server.link);
  await live(page);
});
afterAll(async () => {
  await browser?.close();
  await server?.close();
});

/** Upload a capture from the start of the page and return the id of its scene. */
async function uploaded(name: string, contents: Readonly<Record<string, string>>): Promise<string> {
  await page.goto(`${server.url}/#/`);
  await choose(page, folderOf(name, contents));
  await page.waitForURL(/#\/scenes\//);
  return page.url().split("/").at(-1)!;
}

/** Order a job of the sleeping trainer on a scene's page and return its id. */
async function ordered(scene: string, settings: string): Promise<string> {
  await page.goto(`${server.url}/#/scenes/${scene}`);
  await page.check("input[value=tiny]");
  await page.click("text=More settings");
  await page.fill("#settings", settings);
  await page.click("text=Start the job");
  await page.waitForURL(/#\/jobs\//);
  return page.url().split("/").at(-1)!;
}

const stateIs = (text: string) => page.waitForSelector(`h1 .state:text-is("${text}")`);

describe("logging in", () => {
  it("leaves no code in the address, and works once", async () => {
    expect(page.url()).toBe(`${server.url}/`);
    expect(await page.evaluate(() => document.cookie)).toBe("");
    const stranger = await browser.newContext();
    const other = await stranger.newPage();
    await other.goto(server.link);
    await other.waitForSelector("h1:text-is('Log in')");
    expect(await other.locator("input[type=file]").count()).toBe(0);
    expect(await serious(other)).toEqual([]);
    await other.fill("#link", server.link);
    await other.click("button:text-is('Log in')");
    await other.waitForSelector("text=was used before");
    const headers = { "x-lambent-csrf": "1", origin: server.url };
    const fresh = await page.request.post(`${server.url}/v1/login-links`, { headers });
    await other.fill("#link", ` ${(await fresh.json()).url} `);
    await other.click("button:text-is('Log in')");
    await live(other);
    await stranger.close();
  });

  it("is ended by a button, in this browser only", async () => {
    const headers = { "x-lambent-csrf": "1", origin: server.url };
    const made = await page.request.post(`${server.url}/v1/login-links`, { headers });
    const guest = await browser.newContext();
    const other = await guest.newPage();
    await other.goto((await made.json()).url);
    await live(other);
    await other.click("text=Log out");
    await other.waitForSelector("h1:text-is('Log in')");
    expect(await other.locator("text=Relight your photographs").count()).toBe(0);
    expect(await guest.cookies()).toEqual([]);
    expect((await page.request.get(`${server.url}/v1/jobs`)).status()).toBe(200);
    await guest.close();
  });

  it("comes before everything: the start is empty, usable by all, and fits a phone", async () => {
    await page.waitForSelector("text=None yet.");
    await usable(page);
  });
});

describe("an upload", () => {
  it("leads to the findings and to a choice of presets with their times", async () => {
    await uploaded("bowl", { ...capture, "notes.pdf": "left out" });
    await stateIs("ready");
    await page.waitForSelector("text=NeRF-Blender");
    await page.waitForSelector("text=3 for training, 1 for testing");
    await page.waitForSelector(".presets :text('about 45 seconds')");
    expect(await page.isDisabled("input[value=standard]")).toBe(true);
    expect(await page.isChecked("input[value=fast]")).toBe(true);
    await usable(page);
    await keepPicture(page, "scene");
  });

  it("continues after the page was loaded again, and sends only what is missing", async () => {
    const folder = folderOf(
      "vase",
      Object.fromEntries(Array.from({ length: 8 }, (_, place) => [`train/${place}.png`, `vase ${place}`])),
    );
    let sent = 0;
    let allowed = 3;
    await page.route("**/v1/scenes/*/files/*", async (route) => {
      if (route.request().method() !== "PUT") return route.continue();
      sent += 1;
      // The others wait for ever, as on a bad line.
      return sent <= allowed ? route.continue() : undefined;
    });
    await page.goto(`${server.url}/#/`);
    await choose(page, folder);
    await page.waitForSelector(".upload :text('sending files that the server does not have · 18 B of 48 B')");
    page.once("dialog", (dialog) => dialog.accept());
    await page.reload();
    await live(page);
    allowed = 100;
    sent = 0;
    await page.click("li:has-text('upload not finished') a");
    await page.waitForSelector("text=Drop the same folder again");
    expect(await serious(page)).toEqual([]);
    await choose(page, folder);
    await stateIs("ready");
    expect(sent).toBe(5);
    await page.unroute("**/v1/scenes/*/files/*");
  });

  it("that is not one is explained", async () => {
    await page.goto(`${server.url}/#/`);
    await choose(page, folderOf("papers", { "a.pdf": "x", "b.pdf": "y" }));
    await page.waitForSelector("#message:has-text('no file is planned')");
    const file = (name: string, text: string) => ({ name, mimeType: "", buffer: Buffer.from(text) });
    await page.setInputFiles("input[accept*=zip]", file("photo.jpg", "x"));
    await page.waitForSelector("#message:has-text('alone is not a scene')");
    await page.setInputFiles("input[accept*=zip]", file("broken.zip", "PK but no directory"));
    await page.waitForSelector("#message:has-text('archive cannot be read')");
    expect(await serious(page)).toEqual([]);
    // The browser logs refused requests, which are not the page's fault.
    complaints.splice(0);
  });

  it("of a capture that cannot be used says what to fix, and offers no training", async () => {
    await uploaded("bad", { ...capture, "reject.txt": "x" });
    await stateIs("cannot be used");
    await page.waitForSelector(".findings li:has-text('fix reject.txt')");
    expect(await page.$("text=Start the job")).toBeNull();
    expect(await serious(page)).toEqual([]);
  });
});

describe("a job", () => {
  let scene: string;
  beforeAll(async () => {
    scene = await uploaded("bowl", capture);
    await stateIs("ready");
  });

  it("continues to be shown when the server was killed and started again, and ends with its results", async () => {
    await ordered(scene, "num_steps=120\nstep_s=0.05");
    await page.waitForSelector("text=/step \\d+ of 120/");
    await page.waitForFunction(
      () => (document.querySelector<HTMLImageElement>(".live img")?.naturalWidth ?? 0) > 0,
    );
    await server.kill();
    await page.waitForSelector("#connection:has-text('does not answer')");
    await server.start();
    await live(page);
    await stateIs("done");
    await page.waitForSelector(".chart polyline");
    expect(await page.getAttribute(".chart", "aria-label")).toMatch(/: PSNR on training pixels over time/);
    const link = (await page.getAttribute(".downloads a:text-is('report.json')", "href"))!;
    expect(await page.evaluate(async (url) => (await fetch(url)).json(), link)).toEqual({ metrics: [] });
    expect(await page.$$eval(".downloads a", (all) => all.map((each) => each.textContent))).toEqual([
      "report.json",
      "manifest.json",
      "models/weights.bin",
    ]);
    expect(await page.getAttribute("a.button.first", "href")).toMatch(
      /^viewer\.html#src=%2Fv1%2Fbundles%2Fbundle_/,
    );
    // Only requests to the killed server may have failed.
    const told = complaints.filter(
      (text) => !/ERR_CONNECTION|ERR_INCOMPLETE|ERR_EMPTY|Failed to load resource/.test(text),
    );
    expect(told).toEqual([]);
    await usable(page);
    await keepPicture(page, "job");
  });

  it("leaves out pictures that the server has let go of", async () => {
    await page.waitForSelector(".previews:not([hidden]) img", { state: "attached" });
    await page.route("**/v1/blobs/*", (route) => route.fulfill({ status: 404 }));
    try {
      await page.reload();
      // The history has come, and its pictures with it.
      await page.waitForSelector(".chart polyline", { state: "attached" });
      await page.waitForSelector(".previews[hidden]", { state: "attached" });
    } finally {
      await page.unroute("**/v1/blobs/*");
    }
    await page.reload();
    await page.waitForSelector(".chart polyline", { state: "attached" });
    await page.waitForSelector(".previews:not([hidden]) img", { state: "attached" });
  });

  it("is shown to others by a link, which opens nothing else and is taken back", async () => {
    await page.click("summary:text-is('Share a link')");
    await page.selectOption("#lifetime", { label: "one day" });
    await page.click("text=Create a link");
    const link = await page.inputValue(".shares input");
    const stranger = await browser.newContext();
    const guest = await stranger.newPage();
    const policy = (await guest.goto(link))!.headers()["content-security-policy"];
    expect(policy).toContain("frame-ancestors 'none'");
    await guest.waitForSelector("lambent-viewer");
    const source = (await guest.locator("lambent-viewer").getAttribute("src"))!;
    const [bundle, secret] = [new URL(source).pathname, new URL(source).hash.slice(1)];
    const status = (path: string) =>
      guest.evaluate(
        async ([url, token]) => (await fetch(url, { headers: { authorization: `Bearer ${token}` } })).status,
        [path, secret] as const,
      );
    expect(await status(`${bundle}/manifest`)).toBe(200);
    for (const path of ["/v1/jobs", "/v1/bundles", bundle, `/v1/scenes/${scene}`])
      expect(await status(path)).toBe(401);
    await page.click("text=Revoke");
    await page.waitForSelector("text=no longer works");
    expect(await status(`${bundle}/manifest`)).toBe(401);
    await guest.goto("about:blank");
    await guest.goto(link);
    await guest.waitForSelector("text=revoked");
    expect(await serious(guest)).toEqual([]);
    await stranger.close();
  });

  it("is cancelled and run again by keyboard", async () => {
    await ordered(scene, "num_steps=5000\nstep_s=0.05");
    await stateIs("running");
    const press = async (name: string) => {
      await page.locator("h1").focus();
      for (let tries = 0; tries < 30; tries++) {
        await page.keyboard.press("Tab");
        if ((await page.evaluate(() => document.activeElement?.textContent)) === name) break;
      }
      expect(await page.evaluate(() => document.activeElement?.textContent)).toBe(name);
      await page.keyboard.press("Enter");
    };
    await press("Cancel");
    await stateIs("cancelled");
    const before = page.url();
    await press("Run again");
    await page.waitForURL((url) => url.href !== before);
    await page.waitForSelector("button:text-is('Cancel'):visible");
    await page.click("text=Cancel");
    await stateIs("cancelled");
  });

  it("that has failed says why, and shows its log", async () => {
    await ordered(scene, "num_steps=20\nfail_at=3\nfail_how=worker_error");
    await stateIs("failed");
    await page.waitForSelector(".notice:has-text('the test asked for it'):has-text('test.failed')");
    await page.click("summary:text-is('Log')");
    await page.waitForSelector("pre:has-text('== run 1 ==')");
    expect(await serious(page)).toEqual([]);
  });

  it("is deleted, comes back by keyboard, and is gone when the page is left", async () => {
    await ordered(scene, "num_steps=2");
    await stateIs("done");
    const id = page.url().split("/").at(-1)!;
    const status = () => page.evaluate(async (one) => (await fetch(`/v1/jobs/${one}`)).status, id);
    const inList = `ol[aria-label=Jobs] a[href='#/jobs/${id}']`;
    await page.click("button:text-is('Delete the job')");
    await page.waitForSelector(".toast:has-text('The job \"bowl\" was deleted.')");
    await page.waitForSelector("ol[aria-label=Jobs] li");
    expect(await page.$(inList)).toBeNull();
    expect(await status()).toBe(200);
    expect(await serious(page)).toEqual([]);
    await keepPicture(page, "deleted");
    await page.locator(".toast button").focus();
    await page.keyboard.press("Enter");
    await page.waitForSelector(inList);
    expect(await page.$(".toast")).toBeNull();
    await page.click(inList);
    await page.click("button:text-is('Delete the job')");
    await page.waitForSelector(".toast");
    await page.goto("about:blank");
    await page.goto(`${server.url}/#/`);
    await live(page);
    for (let tries = 0; (await status()) !== 404; tries++) {
      expect(tries).toBeLessThan(50);
      await page.waitForTimeout(100);
    }
    expect(await page.$(inList)).toBeNull();
  });

  it("is found by its name among others, at an address of its own", async () => {
    await page.goto(`${server.url}/#/`);
    await page.waitForSelector("ol[aria-label=Jobs] li");
    await page.fill("#job-words", "nothing like it");
    await page.waitForSelector("text=No job matches.");
    await page.fill("#job-words", "BOW");
    await page.waitForSelector("ol[aria-label=Jobs] li:has-text('bowl')");
    await page.selectOption("select[aria-label=State]", "failed");
    await page.waitForFunction(() => location.hash === "#/?q=BOW&state=failed");
    await page.waitForFunction(() => {
      const states = [...document.querySelectorAll("ol[aria-label=Jobs] .state")];
      return states.length > 0 && states.every((each) => each.textContent === "failed");
    });
    await page.reload();
    await page.waitForSelector("ol[aria-label=Jobs] .state[data-state=failed]");
    expect(await page.inputValue("#job-words")).toBe("BOW");
  });

  it("with a setting that is none is not started", async () => {
    await page.goto(`${server.url}/#/scenes/${scene}`);
    await page.check("input[value=tiny]");
    await page.click("text=More settings");
    await page.fill("#settings", "rays 512");
    await page.click("text=Start the job");
    await page.waitForSelector("#message:has-text('is not a setting')");
  });

  it("is in the list with its scene's name, in dark colours too", async () => {
    await page.emulateMedia({ colorScheme: "dark" });
    await page.goto(`${server.url}/#/`);
    await page.waitForSelector("ol[aria-label^=Jobs] li:has-text('bowl') .state[data-state=succeeded]");
    await page.waitForSelector("ol[aria-label^=Bundles] li:has-text('View bowl')");
    // The sleeper sends a preview, which is the picture of its job.
    await page.waitForFunction(() =>
      [...document.querySelectorAll<HTMLImageElement>("ol[aria-label=Jobs] img")].some(
        (image) => image.naturalWidth > 0,
      ),
    );
    await usable(page);
    await keepPicture(page, "start-dark");
    await page.emulateMedia({ colorScheme: "light" });
  });
});
