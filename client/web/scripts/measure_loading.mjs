// Measures what the viewer fetches of a bundle on a server, and how long that takes, over links of different speed:
//     node scripts/measure_loading.mjs PAGES ADDRESS [OTHER_PAGES]
// ADDRESS is that of a share link's bundle, http://127.0.0.1:8420/v1/bundles/ID#share_... OTHER_PAGES are measured in
// turn, and the server is then asked for nothing compressed: with the build of an earlier version, that is before and
// after. Everything goes through a proxy that counts bytes and takes turns among the connections; every load is the
// first one of a new profile. Prints JSON: milliseconds since the first byte of the manifest, and bytes of the bundle
// that had come by then; "ready" is when the last byte that the first picture needs was read; "processor" is the
// processor time of all of the browser's processes.
import { createServer, request as ask } from "node:http";
import { existsSync, readFileSync, statSync } from "node:fs";
import { delimiter, extname, join, normalize } from "node:path";
import { setTimeout as sleep } from "node:timers/promises";
import { chromium } from "playwright-core";

const [pages, address, others] = process.argv.slice(2);
if (!pages || !address) {
  console.error("usage: node scripts/measure_loading.mjs PAGES ADDRESS [OTHER_PAGES]");
  process.exit(2);
}
const target = new URL(address);
const repeats = 5;
const links = [
  { name: "localhost", megabitsPerS: Infinity, latencyMs: 0 },
  { name: "20 Mbit/s, 40 ms", megabitsPerS: 20, latencyMs: 40 },
  { name: "4 Mbit/s, 80 ms", megabitsPerS: 4, latencyMs: 80 },
];
const chunkBytes = 8192;
const types = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };

let link = links[0];
let freeAt = 0;
/** Time, path and size of everything that was sent of the bundle. */
let sent = [];

/** Wait until it is the turn of some bytes on the link. */
async function turn(bytes) {
  freeAt = Math.max(freeAt, performance.now()) + (bytes * 8) / (link.megabitsPerS * 1000);
  const wait = freeAt - performance.now();
  if (wait > 1) await sleep(wait);
}

function forward(request, response, compressed) {
  const headers = { ...request.headers, host: target.host };
  if (!compressed) delete headers["accept-encoding"];
  const { pathname } = new URL(request.url, "http://x");
  const options = { host: target.hostname, port: target.port, path: request.url, headers };
  const passed = ask({ ...options, method: request.method }, async (answer) => {
    response.writeHead(answer.statusCode, answer.headers);
    try {
      for await (const data of answer) {
        for (let start = 0; start < data.length; start += chunkBytes) {
          const piece = data.subarray(start, start + chunkBytes);
          await turn(piece.length);
          sent.push({ at: Date.now(), path: pathname, bytes: piece.length });
          if (!response.write(piece)) await new Promise((resolve) => response.once("drain", resolve));
        }
      }
    } finally {
      response.end();
    }
  });
  passed.end();
}

async function proxyOf(folder, compressed) {
  const server = createServer(async (request, response) => {
    const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname)).slice(1);
    if (path.startsWith("v1/")) {
      await sleep(link.latencyMs);
      return forward(request, response, compressed);
    }
    const file = join(folder, path);
    if (!statSync(file, { throwIfNoEntry: false })?.isFile()) return response.writeHead(404).end();
    const type = types[extname(file)] ?? "application/octet-stream";
    return response.writeHead(200, { "content-type": type }).end(readFileSync(file));
  });
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return server;
}

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

const system = await browser.newBrowserCDPSession();
/** Processor time of all processes that have lived, milliseconds. */
const known = new Map();
async function processorMs() {
  const { processInfo } = await system.send("SystemInfo.getProcessInfo");
  for (const { id, cpuTime } of processInfo) known.set(id, cpuTime);
  return 1000 * [...known.values()].reduce((sum, value) => sum + value, 0);
}

/** Load the bundle once; returns times since the first byte of its manifest, and bytes by then. */
async function load(server) {
  sent = [];
  const before = await processorMs();
  const context = await browser.newContext({ viewport: { width: 640, height: 480 } });
  const page = await context.newPage();
  page.setDefaultTimeout(300_000);
  await page.addInitScript(() => {
    const watch = () => {
      const viewer = document.querySelector("lambent-viewer")?.viewer;
      if (!viewer) return requestAnimationFrame(watch);
      let loaded = false;
      viewer.on("load", () => {
        loaded = true;
      });
      viewer.on("progress", (readBytes, totalBytes) => {
        if (readBytes > 0 && readBytes === totalBytes) globalThis.ready ??= performance.now();
      });
      const stop = viewer.on("draw", () => {
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
  const site = `http://127.0.0.1:${server.address().port}`;
  const bundle = encodeURIComponent(`${site}${target.pathname}${target.hash}`);
  await page.goto(`${site}/viewer.html#v=2&rotate=0,0,0&src=${bundle}`);
  await page.waitForFunction(() => globalThis.firstPicture !== undefined && globalThis.whole !== undefined);
  const { origin, readyMs, firstMs, wholeMs } = await page.evaluate(() => ({
    origin: performance.timeOrigin,
    readyMs: globalThis.ready,
    firstMs: globalThis.firstPicture,
    wholeMs: globalThis.whole,
  }));
  const usedMs = (await processorMs()) - before;
  await context.close();
  const by = (ms) => sent.filter(({ at }) => at <= origin + ms).reduce((sum, { bytes }) => sum + bytes, 0);
  const files = {};
  for (const { path, bytes } of sent) {
    const name = path.replace(`${target.pathname}/files/`, "");
    files[name] = (files[name] ?? 0) + bytes;
  }
  const began = sent[0].at - origin;
  return {
    ...{ readyMs: readyMs - began, firstMs: firstMs - began, wholeMs: wholeMs - began, processorMs: usedMs },
    ...{ readyBytes: by(readyMs), bytes: by(Infinity), files },
  };
}

const sites = [{ name: "pages", server: await proxyOf(pages, true) }];
if (others) sites.push({ name: "others", server: await proxyOf(others, false) });
const results = {};
for (link of links) {
  const found = Object.fromEntries(sites.map(({ name }) => [name, []]));
  for (let index = 0; index < repeats; index++) {
    for (const { name, server } of [...sites].reverse()) {
      const loaded = await load(server);
      found[name].push(loaded);
      console.error(link.name, name, JSON.stringify(loaded));
    }
  }
  results[link.name] = Object.fromEntries(
    Object.entries(found).map(([name, loads]) => [
      name,
      {
        ...Object.fromEntries(
          ["readyMs", "firstMs", "wholeMs", "processorMs", "readyBytes", "bytes"].map((key) => [
            key,
            loads.map((each) => Math.round(each[key])).sort((a, b) => a - b),
          ]),
        ),
        files: loads.at(-1).files,
      },
    ]),
  );
}
await browser.close();
for (const { server } of sites) server.close();
console.log(JSON.stringify(results, null, 1));
