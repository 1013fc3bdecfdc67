/** One scene: what was found in the capture, and the way to a job. */

import { button } from "../page/actions.js";
import { h, replaceKeyed, section, setText } from "../page/dom.js";
import { formatTime } from "../page/format.js";
import { isFinal, type Scene, type SceneReport } from "../page/rest.js";
import { isListed, jobList, progressText, purpose } from "./jobLine.js";
import { orderForm } from "./orderForm.js";
import { reportSection } from "./report.js";
import { uploadPanel } from "./uploadPanel.js";
import { type Context, sizeText, stateLabel, type View } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** Return the page of a scene that is known. */
export async function sceneView(context: Context, sceneId: string): Promise<View> {
  return new SceneView(context, ...(await read(context, sceneId)));
}

function read({ api }: Context, sceneId: string): Promise<[Scene, SceneReport]> {
  return Promise.all([api.scene(sceneId), api.report(sceneId)]);
}

class SceneView implements View {
  readonly title: string;
  readonly element: HTMLElement;
  readonly #state = h("span");
  readonly #figures = h("p", { class: "faint" });
  readonly #checking = h("p", { class: "notice", role: "status", hidden: true });
  readonly #checkRow = h("div", { class: "actions" });
  readonly #findings = h("div");
  readonly #order = h("div");
  readonly #jobs = jobList(texts.scene.jobs, purpose);
  readonly #jobsSection = section(texts.jobs.title, {}, this.#jobs.element);
  readonly #upload: ReturnType<typeof uploadPanel> | null;
  /** State and stage of each job when the report was last read for it. */
  readonly #seen = new Map<string, string>();

  constructor(
    private readonly context: Context,
    private scene: Scene,
    private report: SceneReport,
  ) {
    this.title = scene.name;
    this.#upload = scene.state === "open" ? uploadPanel(context, scene) : null;
    this.#checkRow.append(button(texts.scene.check, context, () => this.#startCheck()));
    const remove = button(texts.scene.delete, context, async () => this.#delete());
    this.element = h(
      "div",
      {},
      h("p", {}, h("a", { href: "#/" }, texts.start.allJobs)),
      h("h1", { tabindex: -1 }, scene.name, " ", this.#state),
      this.#figures,
      this.#upload !== null && h("section", { "aria-label": texts.scene.upload }, this.#upload.element),
      this.#checking,
      this.#checkRow,
      this.#findings,
      this.#order,
      this.#jobsSection,
      h(
        "section",
        { "aria-label": texts.scene.section },
        h("div", { class: "actions" }, remove),
        h("p", { class: "faint" }, texts.scene.bundlesStay),
      ),
    );
    this.#draw();
    this.#loadJobs().catch(context.fail);
  }

  update(jobId: string | null): void {
    if (jobId === null) {
      this.#reload();
      return;
    }
    const record = this.context.store.get(jobId);
    if (record?.job.scene_id !== this.scene.id) return;
    this.#draw();
    // A check ends with a report, and so does the first step of a job.
    const { id, state, progress } = record.job;
    const now = `${state} ${progress?.stage}`;
    if (this.#seen.get(id) === now) return;
    this.#seen.set(id, now);
    this.#reload();
  }

  close(): void {
    this.#upload?.close();
  }

  #draw(): void {
    const { scene, report, context } = this;
    const all = context.store.all().flatMap(({ job }) => (job.scene_id === scene.id ? [job] : []));
    const running = all.find((job) => job.kind === "check" && !isFinal(job));
    replaceKeyed(this.#state, scene.state, () => [stateLabel(scene.state)]);
    const created = fillIn(texts.scene.created, { time: formatTime(scene.created_at) });
    setText(this.#figures, `${sizeText(scene)}${created}`);
    this.#checking.hidden = running === undefined;
    if (running !== undefined) {
      setText(this.#checking, `${texts.scene.checking} ${progressText(running)}`);
    }
    this.#checkRow.hidden = scene.state !== "uploaded" || running !== undefined;
    replaceKeyed(this.#findings, JSON.stringify(report), () => [reportSection(scene, report)]);
    const usable = scene.state === "ready" || scene.state === "uploaded";
    replaceKeyed(this.#order, String(usable), () => (usable ? [orderForm(context, scene.id)] : []));
    this.#jobs.update(all.filter(isListed));
    this.#jobsSection.hidden = this.#jobs.element.hidden;
  }

  /** The stream begins with the newest jobs of all scenes, which may leave out these. */
  async #loadJobs(): Promise<void> {
    const { api, store } = this.context;
    const { items } = await api.jobs(null, new URLSearchParams({ scene: this.scene.id }));
    for (const job of items) store.put(job);
    this.#draw();
  }

  #reload(): void {
    read(this.context, this.scene.id)
      .then(([scene, report]) => {
        this.scene = scene;
        this.report = report;
        this.#draw();
      })
      .catch(this.context.fail);
  }

  async #startCheck(): Promise<void> {
    const { api, store } = this.context;
    const { id } = this.scene;
    store.put(await api.submit({ scene_id: id, kind: "check" }, `check-${id}-${Date.now()}`));
  }

  #delete(): void {
    const { id, name } = this.scene;
    this.context.removals.ask({
      id,
      what: fillIn(texts.scene.theScene, { name }),
      send: (keepalive) => this.context.api.deleteScene(id, keepalive),
    });
    location.hash = "#/";
  }
}
