// Makes the pictures of docs/howto/web-pages.md from the real pages, a real server and a real job:
//     npm run build && node scripts/pictures.mjs [--settings "NAME=VALUE ..."] [--preset tiny] [--out FOLDER]
// Uploads the sample scene, trains it with a preset (settings as on the page, one per blank), and writes
// web-upload.jpg, web-findings.jpg, web-progress.jpg, web-results.jpg, web-viewer.jpg, web-compare.jpg, web-share.jpg
// and web-phone.jpg into docs/images. None is above 150 KB.
import { spawn } from "node:child_process";
import { existsSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { delimiter, join, resolve } from "node:path";
import { parseArgs } from "node:util";
import { chromium } from "playwright-core";

const root = resolve(import.meta.dirname, "../../..");
const { values: given } = parseArgs({
  options: {
    settings: { type: "string", default: "" },
    preset: { type: "string", default: "tiny" },
    out: { type: "string", default: join(root, "docs/images") },
    python: { type: "string", default: process.env.PYTHON ?? join(root, ".venv/bin/python") },
  },
});
const sample = join(root, "client/python/lambent/sample");
const mostBytes = 150_000;
const hour = 3_600_000;

const data = mkdtempSync(join(tmpdir(), "lambent-pictures-"));
const server = spawn(given.python, ["-m", "lambent", "serve", "--data", data, "--port", "0"], {
  cwd: root,
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
    "--disable-background-networking",
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

/** Change what the viewer shows, and wait for its picture at rest. */
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
  await page.waitForTimeout(2000);
}

try {
  const context = await browser.newContext({ viewport: { width: 1000, height: 680 } });
  const page = await context.newPage();
  page.setDefaultTimeout(hour);
  await page.goto(link);
  await page.waitForFunction(() => document.querySelector("#connection")?.textContent === "live");

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
  await page.waitForSelector(".upload :text('sending what the server lacks')");
  while (sent <= 40) await page.waitForTimeout(200);
  await page.waitForTimeout(500);
  await keep(page, "web-upload");
  release();

  await page.waitForURL(/#\/scenes\//);
  await page.waitForSelector('h1 .state:text-is("ready")');
  await page.check(`input[value=${given.preset}]`);
  await keep(page, "web-findings");
  if (given.settings !== "") {
    await page.click("text=More settings");
    await page.fill("#settings", given.settings.split(" ").join("\n"));
  }
  await page.click("text=Start the job");
  await page.waitForURL(/#\/jobs\//);
  await page.waitForSelector(".chart polyline");
  // The first pictures are fog.
  await page.waitForFunction(() => document.querySelectorAll(".stack img").length > 3);
  await page.evaluate(() => scrollTo(0, 0));
  await keep(page, "web-progress");

  await page.waitForSelector('h1 .state:text-is("done")');
  await page.waitForSelector("#figures dd:has-text('dB')");
  await page.locator("#results").scrollIntoViewIfNeeded();
  await page.waitForSelector(".viewer lambent-viewer:not(.arriving)");
  await page.evaluate(() => document.querySelector("#results").scrollIntoView());
  await keep(page, "web-results");

  await page.click("a.button.first");
  await page.waitForURL(/viewer\.html#src=/);
  await page.waitForFunction(() => / · Lambent viewer$/.test(document.title));
  const near = { azimuthDeg: 35, elevationDeg: 22, distance: 2.6 };
  await view(page, {
    environment: "preset:sunset",
    turn: { yawDeg: 100 },
    pose: near,
    look: { ground: true, exposureEv: 0.5 },
  });
  await keep(page, "web-viewer");
  await view(page, { compare: "environment", environmentB: "preset:studio", environment: "preset:sky" });
  await keep(page, "web-compare");
  await view(page, { compare: "off", environment: "preset:studio" });
  for (const part of ["Light", "Picture"]) await page.click(`summary:text-is('${part}')`);
  await page.click("summary:text-is('Share')");
  await page.click("text=Make a link");
  await page.waitForSelector(".shares li");
  await keep(page, "web-share");

  await page.setViewportSize({ width: 390, height: 700 });
  await page.click("summary:text-is('Controls')");
  await view(page, {});
  await keep(page, "web-phone");
} finally {
  await browser.close();
  server.kill("SIGINT");
  await new Promise((done) => {
    if (server.exitCode !== null) done();
    server.once("exit", done);
  });
  rmSync(data, { recursive: true, force: true });
}
