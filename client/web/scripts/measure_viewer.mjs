// Measures the built viewer in headless Chromium with software graphics, on one bundle:
//     npm run build -- --outDir /tmp/pages && node scripts/measure_viewer.mjs /tmp/pages BUNDLE_FOLDER MAP.exr [OTHER_PAGES]
// Prints JSON: sizes in bytes, times in milliseconds (all of them, not only their medians), wall clock and processor
// time of all of the browser's processes. OTHER_PAGES are measured in turn with the first.
import { createServer } from "node:http";
import { existsSync, readFileSync, statSync } from "node:fs";
import { delimiter, extname, join, normalize } from "node:path";
import { chromium } from "playwright-core";
import { scriptBytes } from "./script_bytes.mjs";

const [pages, bundle, map, others] = process.argv.slice(2);
if (!pages || !bundle || !map) {
  console.error("usage: node scripts/measure_viewer.mjs PAGES BUNDLE_FOLDER MAP.exr");
  process.exit(2);
}
const types = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };
const repeats = 5;
const changes = 50;

const server = createServer((request, response) => {
  const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname)).slice(1);
  let file = join(pages, path);
  if (others && path.startsWith("others/")) file = join(others, path.slice(7));
  if (path === "map.exr") file = map;
  else if (path.startsWith("bundle/")) file = join(bundle, path.slice(7));
  if (!statSync(file, { throwIfNoEntry: false })?.isFile()) return response.writeHead(404).end();
  const data = readFileSync(file);
  const headers = { "content-type": types[extname(file)] ?? "application/octet-stream" };
  const range = /^bytes=(\d+)-(\d+)$/.exec(request.headers.range ?? "");
  if (range === null) return response.writeHead(200, headers).end(data);
  const [from, to] = [Number(range[1]), Number(range[2])];
  response.writeHead(206, { ...headers, "content-range": `bytes ${from}-${to}/${data.length}` });
  return response.end(data.subarray(from, to + 1));
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
const site = `http://127.0.0.1:${server.address().port}`;

function chromiumPath() {
  const folders = (process.env.PATH ?? "").split(delimiter);
  const found = folders.flatMap((folder) =>
    ["chromium", "chromium-browser"].map((name) => join(folder, name)),
  );
  return found.find((path) => existsSync(path));
}

const browser = await chromium.launch({
  executablePath: chromiumPath(),
  args: [
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
  ],
});

browser.on("disconnected", () => console.error("the browser ended"));

const system = await browser.newBrowserCDPSession();
/** Processor time of all processes that have lived, milliseconds. */
const known = new Map();
async function processorMs() {
  const { processInfo } = await system.send("SystemInfo.getProcessInfo");
  for (const { id, cpuTime } of processInfo) known.set(id, cpuTime);
  return 1000 * [...known.values()].reduce((sum, value) => sum + value, 0);
}

async function open(folder) {
  const page = await browser.newPage({ viewport: { width: 640, height: 480 } });
  page.on("crash", () => console.error("the page crashed"));
  page.setDefaultTimeout(300_000);
  await page.addInitScript(() => {
    const watch = () => {
      const viewer = document.querySelector("lambent-viewer")?.viewer;
      if (!viewer) return requestAnimationFrame(watch);
      let loaded = false;
      viewer.on("load", () => {
        loaded = true;
      });
      const stop = viewer.on("draw", () => {
        // Before, there may be an object without its light.
        if (!loaded) return;
        stop();
        // Reading a pixel waits until the picture is there.
        const gl = viewer.canvas.getContext("webgl2");
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
        globalThis.firstPicture = performance.now();
      });
      document.querySelector("lambent-viewer").ready.then(() => {
        globalThis.whole = performance.now();
      });
      return undefined;
    };
    addEventListener("DOMContentLoaded", watch);
  });
  await page.goto(`${site}/${folder}viewer.html#v=2&rotate=0,0,0&src=${site}/bundle/`, { timeout: 300_000 });
  await page.waitForFunction(() => globalThis.firstPicture !== undefined && globalThis.whole !== undefined);
  return page;
}

/** Return the milliseconds from a new map to its picture. */
const lightUp = (page, name) =>
  page.evaluate(async (given) => {
    const element = document.querySelector("lambent-viewer");
    const gl = element.viewer.canvas.getContext("webgl2");
    const data = await (await fetch("/map.exr")).arrayBuffer();
    const start = performance.now();
    await element.setEnvironmentFile(new File([data], given));
    element.viewer.drawNow(1);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return performance.now() - start;
  }, name);

const folders = others ? ["", "others/"] : [""];
const results = Object.fromEntries(
  folders.map((folder) => [
    folder === "" ? "pages" : "others",
    { firstPictureMs: [], wholeMs: [], firstPictureProcessorMs: [], newMapMs: [], newMapProcessorMs: [] },
  ]),
);
let page = null;
for (let index = 0; index < repeats; index++) {
  // The pages named first come last, so that what follows is measured on them.
  for (const folder of [...folders].reverse()) {
    const found = results[folder === "" ? "pages" : "others"];
    await page?.close();
    let before = await processorMs();
    page = await open(folder);
    found.firstPictureMs.push(await page.evaluate(() => globalThis.firstPicture));
    found.wholeMs.push(await page.evaluate(() => globalThis.whole));
    found.firstPictureProcessorMs.push((await processorMs()) - before);
    // The picture at rest is no part of what follows.
    await new Promise((resolve) => setTimeout(resolve, 1000));
    before = await processorMs();
    found.newMapMs.push(await lightUp(page, `map${index}.exr`));
    found.newMapProcessorMs.push((await processorMs()) - before);
  }
}

const rotatedFrameMs = await page.evaluate(async () => {
  const { viewer } = document.querySelector("lambent-viewer");
  const gl = viewer.canvas.getContext("webgl2");
  const times = [];
  for (let index = 0; index < 60; index++) {
    const start = performance.now();
    const done = viewer.update({ turn: { ...viewer.state.turn, yawDeg: (index * 6) % 180 } });
    viewer.drawNow(1);
    times.push(performance.now() - start);
    await done;
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    await new Promise((resolve) => requestAnimationFrame(resolve));
  }
  return times;
});

console.error(JSON.stringify({ results, rotatedFrameMs }));
const session = await page.context().newCDPSession(page);
const heap = async () => {
  await session.send("HeapProfiler.collectGarbage");
  return (await session.send("Runtime.getHeapUsage")).usedSize;
};
const textures = () => page.evaluate(() => document.querySelector("lambent-viewer").viewer.memory.textures);
const change = (name) =>
  page.evaluate(async (given) => {
    const { viewer } = document.querySelector("lambent-viewer");
    await viewer.update({ environment: `preset:${given}` });
    viewer.drawNow(1);
  }, name);
const names = ["studio", "sky", "sunset", "even"];
for (const name of names) await change(name);
const before = { heapBytes: await heap(), textures: await textures() };
for (let index = 0; index < changes; index++) await change(names[index % names.length]);
const after = { heapBytes: await heap(), textures: await textures() };

await browser.close();
server.close();
const memory = { changes, before, after };
console.log(JSON.stringify({ scriptBytes: scriptBytes(pages), ...results, rotatedFrameMs, memory }, null, 1));
