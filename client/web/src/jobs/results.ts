/** Results of a job: the viewer, one-file downloads, share links, and what the figures mean. */

import { archiveAddress, viewerAddress } from "../page/addresses.js";
import { h, section } from "../page/dom.js";
import { formatSize } from "../page/format.js";
import type { Artifact, BundleDetail, Job } from "../page/rest.js";
import { sharePanel } from "../share/panel.js";
import { resultViewer } from "./resultViewer.js";
import { metricRows, type Report, verdicts } from "./verdicts.js";
import type { Context } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** Files of a bundle that other programs open: their path, and the name on the button. */
const assets: readonly [string, string][] = [
  ["mesh/asset.glb", ".glb"],
  ["mesh/asset.usdz", ".usdz"],
];
const posters: readonly string[] = ["poster.webp", "thumbnail.webp"];

/** Return the section; empty for a job without results. */
export function resultSection(context: Context, job: Job, name: string): HTMLElement {
  if (job.state !== "succeeded" || job.kind === "check") return h("div");
  const { api, fail } = context;
  const bundleId = job.bundle_id;
  const place = h("div");
  const buttons = h("div", { class: "actions", id: "results-actions" });
  const figures = h("div", { id: "figures" });
  const files = h("div");

  async function load(): Promise<void> {
    const [{ items }, bundle] = await Promise.all([
      api.artifacts(job.id),
      bundleId === null ? null : api.bundle(bundleId),
    ]);
    if (bundle !== null) place.replaceChildren(resultViewer(shownOf(bundle, name)));
    buttons.replaceChildren(...actionsOf(items, bundle));
    // The page of masks shows those.
    const artifacts = items.filter((artifact) => !artifact.name.startsWith("preparation/"));
    files.replaceChildren(...downloads(artifacts, bundle?.files ?? []));
    const report = items.find((artifact) => artifact.name === "report.json");
    if (report !== undefined) figures.replaceChildren(...told(await api.document<Report>(report.url)));
  }
  load().catch(fail);

  return section(
    texts.results.title,
    { id: "results" },
    place,
    buttons,
    figures,
    bundleId !== null && fold(texts.results.share, sharePanel(context, bundleId)),
    files,
  );
}

function shownOf(bundle: BundleDetail, name: string) {
  const path = posters.find((each) => bundle.files.some((file) => file.path === each));
  const poster = bundle.files.find((file) => file.path === path)?.url ?? bundle.thumbnail_url;
  return { bundleId: bundle.id, name, poster };
}

/** Return the buttons below the viewer. */
function actionsOf(artifacts: readonly Artifact[], bundle: BundleDetail | null): HTMLElement[] {
  const found = bundle === null ? [] : bundleActions(bundle);
  const report = artifacts.find((artifact) => artifact.name === "report.html");
  if (report !== undefined) {
    const link = { class: "button", href: report.url, target: "_blank", rel: "noopener" };
    found.push(h("a", link, texts.results.report, h("span", { class: "sr" }, texts.page.newTab)));
  }
  return found;
}

function bundleActions(bundle: BundleDetail): HTMLElement[] {
  const files = assets.flatMap(([path, suffix]) => {
    const file = bundle.files.find((each) => each.path === path);
    return file === undefined ? [] : [downloadButton(suffix, file.url, fileName(path), file.size_bytes)];
  });
  return [
    h("a", { class: "button first", href: viewerAddress(bundle.id) }, texts.results.fullViewer),
    ...files,
    // The server names the archive, after the scene.
    downloadButton(".relight.zip", archiveAddress(bundle.id), "", bundle.size_bytes),
  ];
}

function downloadButton(suffix: string, url: string, name: string, sizeBytes: number): HTMLElement {
  const link = { class: "button", href: url, download: name };
  return h("a", link, fillIn(texts.results.download, { suffix }), sizeOf(sizeBytes));
}

function sizeOf(sizeBytes: number): HTMLElement {
  return h("span", { class: "faint" }, ` ${formatSize(sizeBytes)}`);
}

function fileName(path: string): string {
  return path.split("/").at(-1)!;
}

function fold(title: string, ...children: readonly HTMLElement[]): HTMLElement {
  return h("details", { class: "fold" }, h("summary", {}, title), ...children);
}

/** Return all files, those of the bundle that are also artifacts once. */
function downloads(artifacts: readonly Artifact[], files: BundleDetail["files"]): HTMLElement[] {
  const known = new Set(artifacts.map((artifact) => artifact.sha256));
  const all = [
    ...artifacts.map((artifact) => ({ ...artifact, path: artifact.name })),
    ...files.filter((file) => !known.has(file.sha256)),
  ];
  if (all.length === 0) return [];
  const lines = all.map(({ url, path, size_bytes }) =>
    h("li", {}, h("a", { href: url, download: fileName(path) }, path), sizeOf(size_bytes)),
  );
  const list = h("ul", { class: "downloads", "aria-label": texts.results.downloads }, ...lines);
  return [fold(fillIn(texts.results.allFiles, { n: all.length }), list)];
}

/** Return the figures in words, and a table of them that opens on a click. */
function told(report: Report): HTMLElement[] {
  const words = verdicts(report).map(({ about, figure, words }) =>
    h("div", {}, h("dt", {}, about), h("dd", {}, h("b", {}, figure), `, ${words}`)),
  );
  return [...(words.length > 0 ? [h("dl", { class: "verdicts" }, ...words)] : []), ...metricTable(report)];
}

function metricTable(report: Report): HTMLElement[] {
  const rows = metricRows(report);
  if (rows.length === 0) return [];
  const views = report.num_views ?? 0;
  const head = views > 0 ? fillIn(texts.results.figureOf, { views }) : texts.results.figure;
  return [fold(texts.results.figures, table(rows, texts.results.figures, head))];
}

/** Return a figure's name, such as "albedo_rgb_ratio/psnr_gamma", that line breaks do not cut within a word. */
function breakable(name: string): Node[] {
  return name
    .split(/(?<=[/_])/)
    .flatMap((piece, place) => [...(place > 0 ? [h("wbr")] : []), document.createTextNode(piece)]);
}

function table(rows: readonly [string, string, string][], label: string, figure: string): HTMLElement {
  const head = [
    h("th", { scope: "col" }, figure),
    h("th", { scope: "col", class: "number" }, texts.results.value),
    h("th", { scope: "col", class: "number" }, texts.results.error),
  ];
  const body = rows.map(([name, value, error]) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, ...breakable(name)),
      h("td", { class: "number" }, value),
      h("td", { class: "number" }, error),
    ),
  );
  return h(
    "div",
    { class: "table", tabindex: 0, role: "region", "aria-label": label },
    h("table", {}, h("thead", {}, h("tr", {}, ...head)), h("tbody", {}, ...body)),
  );
}
