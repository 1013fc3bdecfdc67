// Compares what frames of two builds of the viewer cost, in turn in one browser with software graphics:
//     node scripts/compare_frames.mjs PAGES_BEFORE PAGES_AFTER BUNDLE_FOLDER [PICTURES_FOLDER]
// Prints JSON: medians and quartiles in milliseconds of frames that wait for the picture, per kind and build, and the
// ratio of the medians. In PICTURES_FOLDER, if named, it leaves a picture of each build.
import { createServer } from "node:http";
import { existsSync, mkdirSync, readFileSync, statSync, writeFileSync } from "node:fs";
import { delimiter, extname, join, normalize } from "node:path";
import { chromium } from "playwright-core";

const [before, after, bundle, pictures] = process.argv.slice(2);
if (!before || !after || !bundle) {
  console.error(
    "usage: node scripts/compare_frames.mjs PAGES_BEFORE PAGES_AFTER BUNDLE_FOLDER [PICTURES_FOLDER]",
  );
  process.exit(2);
}
const types = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml" };
const folders = { before, after, bundle };
const rounds = 5;

const server = createServer((request, response) => {
  const path = normalize(decodeURIComponent(new URL(request.url, "http://x").pathname)).slice(1);
  const [first, ...rest] = path.split("/");
  const file = join(folders[first] ?? before, ...rest);
  if (!statSync(file, { throwIfNoEntry: false })?.isFile()) return response.writeHead(404).end();
  response.writeHead(200, { "content-type": types[extname(file)] ?? "application/octet-stream" });
  return response.end(readFileSync(file));
});
await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
const site = `http://127.0.0.1:${server.address().port}`;

const found = (process.env.PATH ?? "")
  .split(delimiter)
  .flatMap((folder) => ["chromium", "chromium-browser"].map((name) => join(folder, name)))
  .find((path) => existsSync(path));
const browser = await chromium.launch({
  executablePath: found,
  args: ["--headless", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});

/** Frames of a kind, in milliseconds until a pixel can be read. */
const frames = (page, kind, count) =>
  page.evaluate(
    async ([asked, number]) => {
      const { viewer } = document.querySelector("lambent-viewer");
      const gl = viewer.canvas.getContext("webgl2");
      const pixel = new Uint8Array(4);
      const times = [];
      for (let index = 0; index < number + 2; index++) {
        const { turn, pose } = viewer.state;
        const change =
          asked === "light"
            ? { turn: { ...turn, yawDeg: ((index * 7 + 180) % 360) - 180 } }
            : { pose: { ...pose, azimuthDeg: ((index * 3 + 180) % 360) - 180 } };
        const done = viewer.update(change);
        const start = performance.now();
        viewer.drawNow(asked === "rest" ? 2 : 1);
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        if (index >= 2) times.push(performance.now() - start);
        await done;
      }
      return times;
    },
    [kind, count],
  );

async function open(name) {
  const page = await browser.newPage({ viewport: { width: 900, height: 600 } });
  page.on("pageerror", (error) => console.error(error));
  const state = "env=preset:sunset&camera=30,20,2.2,0,0,0";
  await page.goto(`${site}/${name}/viewer.html#src=${site}/bundle/&${state}`);
  await page.waitForFunction(() => document.querySelector("lambent-viewer")?.viewer != null);
  await page.evaluate(() => document.querySelector("lambent-viewer").ready);
  await page.waitForTimeout(1500);
  return page;
}

const pages = { before: await open("before"), after: await open("after") };
if (pictures) {
  mkdirSync(pictures, { recursive: true });
  for (const [name, page] of Object.entries(pages)) {
    writeFileSync(join(pictures, `${name}.png`), await page.screenshot());
  }
}
const times = {};
for (const kind of ["camera", "light", "rest"]) {
  times[kind] = { before: [], after: [] };
  for (let round = 0; round < rounds; round++) {
    for (const name of ["before", "after"]) times[kind][name].push(...(await frames(pages[name], kind, 12)));
  }
}
const quantile = (values, share) => values.sort((a, b) => a - b)[Math.floor(share * (values.length - 1))];
const summary = (values) => [0.25, 0.5, 0.75].map((share) => Number(quantile(values, share).toFixed(2)));
const result = Object.fromEntries(
  Object.entries(times).map(([kind, { before: old, after: now }]) => [
    kind,
    { before: summary(old), after: summary(now), ratio: quantile(now, 0.5) / quantile(old, 0.5) },
  ]),
);
console.log(JSON.stringify(result, null, 1));
await browser.close();
server.close();
