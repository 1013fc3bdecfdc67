/** One scene: what was found in the capture, and the way to a job. */

import { button } from "../page/actions.js";
import { h, replaceKeyed, section, setText } from "../page/dom.js";
import { formatSize, formatTime } from "../page/format.js";
import type { Scene, SceneReport } from "../page/rest.js";
import { isListed, jobList, progressText, purpose } from "./jobLine.js";
import { orderForm } from "./orderForm.js";
import { reportSection } from "./report.js";
import { isFinal } from "./store.js";
import { uploadPanel } from "./uploadPanel.js";
import { type Context, stateLabel, type View } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** Return the page of a scene that is known. */
export async function sceneView(context: Context, sceneId: string): Promise<View> {
  const { api, store, fail } = context;
  let [scene, report]: [Scene, SceneReport] = await Promise.all([api.scene(sceneId), api.report(sceneId)]);

  const state = h("span");
  const figures = h("p", { class: "faint" });
  const panel = scene.state === "open" ? uploadPanel(context, scene) : null;
  const checking = h("p", { class: "notice", role: "status", hidden: true });
  const check = button(texts.scene.check, context, () => startCheck(context, sceneId));
  const checkRow = h("div", { class: "actions" }, check);
  const findings = h("div");
  const order = h("div");
  const jobs = jobList(texts.scene.jobs, purpose);
  const jobsSection = section(texts.jobs.title, {}, jobs.element);
  const remove = button(texts.scene.delete, context, async () => {
    context.removals.ask({
      id: sceneId,
      what: fillIn(texts.scene.theScene, { name: scene.name }),
      send: (keepalive) => api.deleteScene(sceneId, keepalive),
    });
    location.hash = "#/";
  });

  const seen = new Map<string, string>();
  const mine = () => store.all().filter(({ job }) => job.scene_id === sceneId);

  function draw(): void {
    const all = mine().map(({ job }) => job);
    const running = all.find((job) => job.kind === "check" && !isFinal(job));
    replaceKeyed(state, scene.state, () => [stateLabel(scene.state)]);
    const size =
      scene.num_files > 0
        ? `${fillIn(texts.page.files, { n: scene.num_files })}, ${formatSize(scene.size_bytes)} · `
        : "";
    setText(figures, `${size}${fillIn(texts.scene.created, { time: formatTime(scene.created_at) })}`);
    checking.hidden = running === undefined;
    if (running !== undefined) {
      const progress = progressText(running);
      setText(checking, `${texts.scene.checking} ${progress}`);
    }
    checkRow.hidden = scene.state !== "uploaded" || running !== undefined;
    replaceKeyed(findings, JSON.stringify(report), () => [reportSection(scene, report)]);
    const usable = scene.state === "ready" || scene.state === "uploaded";
    replaceKeyed(order, String(usable), () => (usable ? [orderForm(context, sceneId)] : []));
    jobs.update(all.filter(isListed));
    jobsSection.hidden = jobs.element.hidden;
  }

  // The stream begins with the newest jobs of all scenes, which may leave out these.
  async function loadJobs(): Promise<void> {
    const { items } = await api.jobs(null, new URLSearchParams({ scene: sceneId }));
    for (const job of items) store.put(job);
    draw();
  }

  async function reload(): Promise<void> {
    [scene, report] = await Promise.all([api.scene(sceneId), api.report(sceneId)]);
    draw();
  }
  draw();
  loadJobs().catch(fail);

  return {
    title: scene.name,
    element: h(
      "div",
      {},
      h("p", {}, h("a", { href: "#/" }, texts.start.allJobs)),
      h("h1", { tabindex: -1 }, scene.name, " ", state),
      figures,
      panel !== null && h("section", { "aria-label": texts.scene.upload }, panel.element),
      checking,
      checkRow,
      findings,
      order,
      jobsSection,
      h(
        "section",
        { "aria-label": texts.scene.section },
        h("div", { class: "actions" }, remove),
        h("p", { class: "faint" }, texts.scene.bundlesStay),
      ),
    ),
    update: (jobId) => {
      if (jobId === null) {
        reload().catch(fail);
        return;
      }
      const record = store.get(jobId);
      if (record?.job.scene_id !== sceneId) return;
      draw();
      // A check ends with a report, and so does the first step of a job.
      const { id, state, progress } = record.job;
      const now = `${state} ${progress?.stage}`;
      if (seen.get(id) === now) return;
      seen.set(id, now);
      reload().catch(fail);
    },
    close: () => panel?.close(),
  };
}

async function startCheck({ api, store }: Context, sceneId: string): Promise<void> {
  store.put(await api.submit({ scene_id: sceneId, kind: "check" }, `check-${sceneId}-${Date.now()}`));
}
