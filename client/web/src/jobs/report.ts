/** The report on a capture: its layout, findings, and measurements. */

import { h, section } from "../page/dom.js";
import { plural } from "../page/format.js";
import type { Finding, Scene, SceneReport } from "../page/rest.js";

const layouts: ReadonlyMap<string, string> = new Map([
  ["tensoir_synthetic", "TensoIR-synthetic"],
  ["openillumination", "OpenIllumination"],
  ["glossy_synthetic", "Glossy Synthetic"],
  ["nerf_blender", "NeRF-Blender (transforms_*.json)"],
  ["nerfstudio", "nerfstudio or instant-ngp (transforms.json)"],
  ["colmap", "COLMAP"],
  ["photographs", "photographs, whose cameras are found first"],
]);

/** Return the name of a layout for display. */
export function layoutName(layout: string): string {
  return layouts.get(layout) ?? layout;
}

/** Return the findings, errors first, each kind in the order it came in. */
export function ordered(findings: readonly Finding[]): Finding[] {
  return [...findings].sort((a, b) => Number(b.severity === "error") - Number(a.severity === "error"));
}

/** Return the lines of the table of what was measured. */
export function measured(report: SceneReport): [string, string][] {
  const rows: [string, string][] = [];
  if (report.layout !== "") rows.push(["Layout", layoutName(report.layout)]);
  if (report.num_train_frames + report.num_test_frames > 0) {
    const held = report.num_test_frames > 0 ? `, ${report.num_test_frames} to test` : "";
    rows.push(["Views", `${report.num_train_frames} to train on${held}`]);
  }
  const { figures } = report;
  if (figures === null) return rows;
  if (figures.lacks_cameras) return rows;
  rows.push(["Largest gap between views", `${figures.upper_gap_deg.toFixed(0)}° of the upper half`]);
  const heights = `${figures.lowest_elevation_deg.toFixed(0)}° to ${figures.highest_elevation_deg.toFixed(0)}°`;
  rows.push(["Heights of the cameras", heights]);
  rows.push(["Exposure differs by", `${figures.exposure_range_ev.toFixed(2)} EV`]);
  rows.push(["Masks", figures.has_masks ? "yes" : "no"]);
  return rows;
}

/** Return the section about a scene; empty before the first check. */
export function reportSection(scene: Scene, report: SceneReport): HTMLElement {
  const findings = ordered(report.findings);
  const rows = measured(report);
  if (!report.checked && findings.length === 0) return h("div");
  const errors = findings.filter((finding) => finding.severity === "error").length;
  const summary = report.checked ? verdict(errors, findings.length - errors) : "Not checked yet.";
  return section(
    "What was found",
    { id: "report" },
    h("p", {}, summary),
    rows.length > 0 && table(rows),
    findings.length > 0 &&
      h("ul", { class: "findings", "aria-label": "Findings" }, ...findings.map(findingLine)),
    report.checked &&
      report.figures !== null &&
      h(
        "p",
        { class: "actions" },
        h(
          "a",
          { href: `/v1/scenes/${scene.id}/report?format=html`, target: "_blank", rel: "noopener" },
          "Report with thumbnails (opens in a new tab)",
        ),
      ),
  );
}

function verdict(errors: number, notes: number): string {
  if (errors > 0) {
    return `This capture cannot be used yet: fix ${plural(errors, "problem")} and upload it again.`;
  }
  if (notes > 0) return `This capture can be used. ${plural(notes, "note")} on how to improve it:`;
  return "This capture can be used; no problems were found.";
}

function table(rows: readonly [string, string][]): HTMLElement {
  return h(
    "div",
    { class: "table" },
    h(
      "table",
      {},
      h(
        "tbody",
        {},
        ...rows.map(([name, value]) => h("tr", {}, h("th", { scope: "row" }, name), h("td", {}, value))),
      ),
    ),
  );
}

function findingLine(finding: Finding): HTMLLIElement {
  const kind = finding.severity === "error" ? "To fix" : "Note";
  const about = finding.subject === "" ? "" : `${finding.subject}: `;
  return h(
    "li",
    { "data-severity": finding.severity },
    h("b", {}, kind),
    ` ${about}${finding.message} `,
    h("code", { class: "faint" }, finding.code),
  );
}
