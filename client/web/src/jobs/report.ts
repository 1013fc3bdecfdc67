/** The report on a capture: its layout, findings, and measurements. */

import { h, section } from "../page/dom.js";
import { formatNumber } from "../page/format.js";
import type { Finding, Scene, SceneReport } from "../page/rest.js";
import { fillIn, texts } from "../words/words.js";

function titleOf({ layout, layout_title }: SceneReport): string {
  return layout === "photographs" ? texts.scene.photographs : layout_title;
}

/** Return the findings, errors first, each kind in the order it came in. */
export function ordered(findings: readonly Finding[]): Finding[] {
  return [...findings].sort((a, b) => Number(b.severity === "error") - Number(a.severity === "error"));
}

/** Return the lines of the table of what was measured. */
export function measured(report: SceneReport): [string, string][] {
  const rows: [string, string][] = [];
  if (report.layout !== "") rows.push([texts.scene.layout, titleOf(report)]);
  if (report.num_train_frames + report.num_test_frames > 0) {
    const parts = [fillIn(texts.scene.trainViews, { number: report.num_train_frames })];
    if (report.num_test_frames > 0)
      parts.push(fillIn(texts.scene.testViews, { number: report.num_test_frames }));
    rows.push([texts.scene.views, parts.join(", ")]);
  }
  const { figures } = report;
  if (figures === null) return rows;
  if (figures.lacks_cameras) return rows;
  rows.push([texts.scene.gap, fillIn(texts.scene.gapOf, { degrees: formatNumber(figures.upper_gap_deg) })]);
  const heights = fillIn(texts.page.range, {
    from: `${formatNumber(figures.lowest_elevation_deg)}°`,
    to: `${formatNumber(figures.highest_elevation_deg)}°`,
  });
  rows.push([texts.scene.heights, heights]);
  rows.push([texts.scene.exposure, `${formatNumber(figures.exposure_range_ev, 2)} EV`]);
  rows.push([texts.scene.masks, figures.has_masks ? texts.scene.yes : texts.scene.no]);
  return rows;
}

/** Return the section about a scene; empty before the first check. */
export function reportSection(scene: Scene, report: SceneReport): HTMLElement {
  const findings = ordered(report.findings);
  const rows = measured(report);
  if (!report.checked && findings.length === 0) return h("div");
  const errors = findings.filter((finding) => finding.severity === "error").length;
  const summary = report.checked ? verdict(errors, findings.length - errors) : texts.scene.notChecked;
  return section(
    texts.scene.found,
    { id: "report" },
    h("p", {}, summary),
    rows.length > 0 && table(rows),
    findings.length > 0 &&
      h("ul", { class: "findings", "aria-label": texts.scene.findings }, ...findings.map(findingLine)),
    report.checked &&
      report.figures !== null &&
      h(
        "p",
        { class: "actions" },
        h(
          "a",
          { href: `/v1/scenes/${scene.id}/report?format=html`, target: "_blank", rel: "noopener" },
          texts.scene.report,
        ),
      ),
  );
}

function verdict(errors: number, notes: number): string {
  if (errors > 0) return fillIn(texts.scene.unusable, { n: errors });
  return notes > 0 ? fillIn(texts.scene.usableNotes, { n: notes }) : texts.scene.usable;
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
  const kind = finding.severity === "error" ? texts.scene.toFix : texts.scene.note;
  const about = finding.subject === "" ? "" : `${finding.subject}: `;
  return h(
    "li",
    { "data-severity": finding.severity },
    h("b", {}, kind),
    ` ${about}${finding.message} `,
    h("code", { class: "faint" }, finding.code),
  );
}
