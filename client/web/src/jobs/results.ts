/** Results of a job: metrics, downloads, the viewer, and share links. */

import { viewerAddress } from "../page/addresses.js";
import { h, section } from "../page/dom.js";
import { formatSize } from "../page/format.js";
import type { Artifact, BundleDetail, Job } from "../page/rest.js";
import { sharePanel } from "../share/panel.js";
import type { Context } from "./view.js";

/** The part of report.json (lambent_proto.v1.EvaluationReport) that is shown. */
export type Report = {
  readonly metrics?: readonly {
    readonly name: string;
    readonly value: number;
    readonly unit?: string;
    readonly standard_error?: number;
  }[];
  readonly num_views?: number;
  readonly notes?: readonly string[];
};

/** Return the rows of the table of figures: name, value with unit, standard error. */
export function metricRows(report: Report): [string, string, string][] {
  return (report.metrics ?? []).map(({ name, value, unit = "", standard_error: error = 0 }) => {
    const suffix = unit === "" || unit === "1" ? "" : ` ${unit}`;
    const digits = unit === "dB" || unit === "deg" ? 2 : 4;
    return [name, `${value.toFixed(digits)}${suffix}`, error > 0 ? `± ${error.toFixed(digits)}` : ""];
  });
}

/** Figures that are seen at once; the others are a click away. */
const headlines: ReadonlySet<string> = new Set([
  "nvs/psnr",
  "nvs/ssim",
  "albedo_rgb_ratio/psnr_gamma",
  "normal/mae_mask",
  "roughness/rmse",
]);

/** Return the section; empty for a job without results. */
export function resultSection(context: Context, job: Job, name: string): HTMLElement {
  if (job.state !== "succeeded" || job.kind === "check") return h("div");
  const { api, fail } = context;
  const bundleId = job.bundle_id;
  const figures = h("div", { id: "figures" });
  const downloads = h("ul", { class: "downloads", "aria-label": "Downloads" });

  async function load(): Promise<void> {
    const [{ items }, bundle] = await Promise.all([
      api.artifacts(job.id),
      bundleId === null ? null : api.bundle(bundleId),
    ]);
    // The page of masks shows those.
    const files = items.filter(({ name }) => !name.startsWith("preparation/"));
    downloads.replaceChildren(...downloadLines(files, bundle?.files ?? []));
    const report = items.find((artifact) => artifact.name === "report.json");
    if (report !== undefined) figures.replaceChildren(...metricTable(await api.document<Report>(report.url)));
  }
  load().catch(fail);

  return section(
    "Results",
    { id: "results" },
    bundleId !== null &&
      h(
        "div",
        { class: "actions" },
        h("a", { class: "button first", href: viewerAddress(bundleId) }, `Open ${name} in the viewer`),
      ),
    figures,
    h("h3", {}, "Downloads"),
    downloads,
    bundleId !== null &&
      h("p", { class: "faint" }, "All at once: ", h("code", {}, `lambent fetch ${job.id} -o bundle`)),
    bundleId !== null && sharePanel(context, bundleId),
  );
}

function downloadLines(artifacts: readonly Artifact[], files: BundleDetail["files"]): HTMLElement[] {
  const line = (url: string, path: string, sizeBytes: number) =>
    h(
      "li",
      {},
      h("a", { href: url, download: path.split("/").at(-1)! }, path),
      h("span", { class: "faint" }, ` ${formatSize(sizeBytes)}`),
    );
  const known = new Set(artifacts.map((artifact) => artifact.sha256));
  return [
    ...artifacts.map((artifact) => line(artifact.url, artifact.name, artifact.size_bytes)),
    ...files
      .filter((file) => !known.has(file.sha256))
      .map((file) => line(file.url, file.path, file.size_bytes)),
  ];
}

function metricTable(report: Report): HTMLElement[] {
  const rows = metricRows(report);
  if (rows.length === 0) return [];
  const first = rows.filter(([name]) => headlines.has(name));
  const views = report.num_views ? `, mean of ${report.num_views} views` : "";
  if (first.length === 0 || first.length === rows.length) return [table(rows, "Evaluation", views)];
  const rest = rows.filter(([name]) => !headlines.has(name));
  const more = h(
    "details",
    {},
    h("summary", {}, "All other figures"),
    table(rest, "All other figures", views),
  );
  return [table(first, "Evaluation", views), more];
}

function table(rows: readonly [string, string, string][], label: string, views: string): HTMLElement {
  const head = [
    h("th", { scope: "col" }, `Figure${views}`),
    h("th", { scope: "col", class: "number" }, "Value"),
    h("th", { scope: "col", class: "number" }, "Standard error"),
  ];
  const body = rows.map(([name, value, error]) =>
    h(
      "tr",
      {},
      h("th", { scope: "row" }, name),
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
