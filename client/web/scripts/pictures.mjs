// Makes the pictures of docs/howto/web-pages.md from the real pages, a real server and a real job:
//     npm run build && node scripts/pictures.mjs [--settings "NAME=VALUE ..."] [--preset tiny] [--out FOLDER] [--data FOLDER]
// Uploads the sample scene, trains it with a preset (settings as on the page, one per blank), and writes
// web-upload.jpg, web-findings.jpg, web-progress.jpg, web-results.jpg, web-viewer.jpg, web-compare.jpg, web-share.jpg
// and web-phone.jpg into docs/images. None is above 150 KB. --data keeps what the server stores, and bundle.relight.zip;
// with a folder that was kept, nothing is trained and the first three pictures stay.
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { delimiter, join, resolve } from "node:path";
import { parseArgs } from "node:util";
import { chromium } from "playwright-core";
import english from "../src/words/en.json" with { type: "json" };

const root = resolve(import.meta.dirname, "../../..");
const { values: given } = parseArgs({
  options: {
    settings: { type: "string", default: "" },
    preset: { type: "string", default: "tiny" },
    out: { type: "string", default: join(root, "docs/images") },
    data: { type: "string" },
    python: { type: "string", default: process.env.PYTHON ?? join(root, ".venv/bin/python") },
  },
});
// The pages' own texts, so that a new wording breaks nothing here.
const { texts } = english;
const sample = join(root, "client/python/lambent/sample");
const packages = ["worker", "client/python", "server", "proto"];
const mostBytes = 150_000;
const hour = 3_600_000;

const data = given.data ?? mkdtempSync(join(tmpdir(), "lambent-pictures-"));
const archive = join(data, "bundle.relight.zip");
const server = spawn(given.python, ["-m", "lambent", "serve", "--data", data, "--port", "0"], {
  cwd: root,
  // The packages of this checkout, whatever .venv has installed.
  env: { ...process.env, PYTHONPATH: packages.map((name) => join(root, name)).join(delimiter) },
  stdio: ["ignore", "pipe", "inherit"],
});
let printed = "";
server.stdout.on("data", (piece) => {
  printed += piece;
});
while (!printed.includes("Key for programs")) {
  if (server.exitCode !== null) throw new Error("the server did not start");
  await new Promise((done) => setTimeout(done, 100));
}
const link = /Open \(once\): (\S+)/.exec(printed)[1];

const program = (process.env.PATH ?? "")
  .split(delimiter)
  .flatMap((folder) => ["chromium", "chromium-browser"].map((name) => join(folder, name)))
  .find((path) => existsSync(path));
const browser = await chromium.launch({
  executablePath: program,
  args: [
    ...["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
    ...["--disable-background-networking", "--lang=en-US", "--accept-lang=en-US"],
  ],
});

/** Write what a page shows. */
async function keep(page, name, options = {}) {
  for (const quality of [82, 70, 55, 40]) {
    const picture = await page.screenshot({ type: "jpeg", quality, ...options });
    if (picture.length > mostBytes) continue;
    const path = join(given.out, `${name}.jpg`);
    writeFileSync(path, picture);
    console.log(path, picture.length);
    return;
  }
  throw new Error(`${name} stays above ${mostBytes} bytes`);
}

/** Wait until the viewer has drawn its lights, and its picture at rest. */
async function drawn(page) {
  await page.waitForFunction(() => {
    const chips = document.querySelector("lambent-viewer").shadowRoot.querySelectorAll(".chip canvas");
    return [...chips].every((each) => {
      const { data } = each.getContext("2d").getImageData(each.width / 2, each.height / 2, 1, 1);
      return data[3] > 0;
    });
  });
  await page.evaluate(async () => {
    const { viewer } = document.querySelector("lambent-viewer");
    let last = performance.now();
    const stop = viewer.on("draw", () => {
      last = performance.now();
    });
    while (performance.now() - last < 2000) await new Promise((done) => setTimeout(done, 50));
    stop();
  });
}

/** Change what the viewer shows, and wait for its picture. */
async function view(page, change) {
  await page.evaluate(async (asked) => {
    const element = document.querySelector("lambent-viewer");
    const { look, turn, pose } = element.state;
    await element.update({
      ...asked,
      look: { ...look, ...asked.look },
      turn: { ...turn, ...asked.turn },
      pose: { ...pose, ...asked.pose },
    });
    element.viewer.drawNow(2);
  }, change);
  await drawn(page);
}

const wide = { width: 1000, height: 680 };
const tall = { width: 1000, height: 860 };

/** Take the pictures from the upload to the end of the job. */
async function train(page) {
  // Half of the files wait, so that there is something to see of the upload.
  let sent = 0;
  let release = () => {};
  const gate = new Promise((done) => {
    release = done;
  });
  await page.route("**/v1/scenes/*/files/*", async (route) => {
    sent += 1;
    if (sent > 40) await gate;
    await route.continue();
  });
  await page.setInputFiles("input[type=file][webkitdirectory]", sample);
  await page.waitForSelector(`.upload :text("${texts.upload.steps.send}")`);
  while (sent <= 40) await page.waitForTimeout(200);
  await page.waitForTimeout(500);
  await keep(page, "web-upload");
  release();

  await page.waitForURL(/#\/scenes\//);
  await page.waitForSelector(`h1 .state:text-is("${texts.states.ready}")`);
  await page.check(`input[value=${given.preset}]`);
  await page.setViewportSize(tall);
  await page.evaluate(() => scrollTo(0, 0));
  await keep(page, "web-findings");
  if (given.settings !== "") {
    await page.click(`text=${texts.order.more}`);
    await page.fill("#settings", given.settings.split(" ").join("\n"));
  }
  await page.click(`text=${texts.order.start}`);
  await page.waitForURL(/#\/jobs\//);
  await page.waitForSelector(".chart polyline");
  // The first previews of a stage are fog: the newest one, once materials and light are half done.
  await page.waitForSelector(".previews input[type=range]:visible");
  await page.locator(".previews input[type=range]").evaluate((slider) => {
    slider.value = slider.max;
    slider.dispatchEvent(new Event("input"));
  });
  await page.waitForFunction((stage) => {
    const [, step, steps] = /(\d+) \D+ (\d+)/.exec(document.querySelector("p.figures").textContent) ?? [];
    const shown = document.querySelector(".previews figcaption").textContent;
    return shown.startsWith(stage) && Number(step) > Number(steps) / 2;
  }, texts.stages.joint);
  await page.evaluate(() => scrollTo(0, 0));
  await keep(page, "web-progress");
  await page.waitForSelector(`h1 .state:text-is("${texts.states.succeeded}")`);
}

/** Take the pictures of the results, on the page of the job. */
async function show(page) {
  await page.waitForSelector("#figures dd:has-text('dB')");
  await page.setViewportSize({ ...wide, height: 790 });
  await page.locator("#results").scrollIntoViewIfNeeded();
  await page.waitForSelector(".viewer lambent-viewer:not(.arriving)");
  await page.evaluate(() => document.querySelector("#results").scrollIntoView());
  await view(page, {});
  await keep(page, "web-results");
  const { href } = await page.locator("#results-actions a[href$=archive]").evaluate(({ href }) => ({ href }));
  writeFileSync(archive, await (await page.request.get(href)).body());

  await page.setViewportSize(wide);
  await page.click("a.button.first");
  await page.waitForURL(/viewer\.html#src=/);
  await page.waitForFunction(
    (wanted) => document.title.endsWith(wanted),
    texts.viewer.pageOf.replace("{name}", ""),
  );
  const near = { azimuthDeg: 35, elevationDeg: 22, distance: 2.6 };
  await view(page, {
    environment: "preset:sunset",
    turn: { yawDeg: 100 },
    pose: near,
    look: { ground: true, exposureEv: 0.7 },
  });
  await keep(page, "web-viewer");
  await view(page, { compare: "environment", environmentB: "preset:studio", environment: "preset:sky" });
  await keep(page, "web-compare");
  await view(page, { compare: "off", environment: "preset:studio" });
  const listed = page.waitForResponse((response) => response.url().endsWith("/shares"));
  for (const part of [texts.panel.light, texts.panel.picture, texts.panel.share]) {
    await page.click(`summary:text-is("${part}")`);
  }
  // Links of an earlier run.
  for (const { id } of (await (await listed).json()).items) {
    const gone = await page.request.delete(new URL(`/v1/shares/${id}`, page.url()).href, {
      headers: { "x-lambent-csrf": "1" },
    });
    if (!gone.ok()) throw new Error(`a link stays: ${gone.status()}`);
  }
  await page.click(`text=${texts.share.create}`);
  await page.waitForSelector(".shares li");
  await keep(page, "web-share");

  await page.setViewportSize({ width: 390, height: 700 });
  await page.click(`summary:text-is("${texts.panel.controls}")`);
  await view(page, {});
  await keep(page, "web-phone");
}

try {
  const context = await browser.newContext({ viewport: wide });
  const page = await context.newPage();
  page.setDefaultTimeout(hour);
  await page.goto(link);
  await page.waitForFunction(
    (live) => document.querySelector("#connection")?.textContent === live,
    texts.connection.live,
  );
  if (existsSync(archive)) {
    const trained = `.faint:text("${texts.jobs.preset.replace("{name}", "").trim()}")`;
    await page
      .locator(`li:has(.state:text-is("${texts.states.succeeded}")):has(${trained}) h3 a`)
      .first()
      .click();
  } else await train(page);
  await show(page);
} finally {
  await browser.close();
  server.kill("SIGINT");
  await new Promise((done) => {
    if (server.exitCode !== null) done();
    server.once("exit", done);
  });
  if (given.data === undefined) rmSync(data, { recursive: true, force: true });
}
