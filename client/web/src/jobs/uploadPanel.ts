/** The panel for dropping or choosing photographs, with the current uploads. */

import { sceneAddress } from "../page/addresses.js";
import { arrange, h, setText } from "../page/dom.js";
import { chosenFiles, droppedEntries, filesIn } from "../page/files.js";
import { formatSize } from "../page/format.js";
import type { Scene } from "../page/rest.js";
import { type Candidate, collect } from "../upload/collect.js";
import type { UploadStep } from "../upload/upload.js";
import type { Running } from "../upload/uploads.js";
import type { Context } from "./view.js";
import { fillIn, texts } from "../words/words.js";

/** Return the status of an upload in a line. */
export function describe(step: UploadStep): string {
  const parts = [texts.upload.steps[step.what] as string];
  if (step.totalBytes > 0)
    parts.push(
      fillIn(texts.page.of, { part: formatSize(step.doneBytes), whole: formatSize(step.totalBytes) }),
    );
  if (step.numKnown > 0) parts.push(fillIn(texts.upload.known, { n: step.numKnown }));
  return parts.join(" · ");
}

/** Return the panel; `scene` is one whose upload was broken off, null makes new ones. */
export function uploadPanel(
  context: Context,
  scene: Scene | null,
): { element: HTMLElement; close: () => void } {
  const { uploads, fail } = context;

  async function take(files: Promise<ReadonlyMap<string, File>> | ReadonlyMap<string, File>): Promise<void> {
    await send(context, await collect(await files), scene?.id ?? null);
  }

  const chooser = (kind: "folder" | "photographs" | "archive") => {
    const input = h("input", { type: "file", hidden: true, "aria-hidden": "true", tabindex: -1 });
    if (kind === "folder") input.webkitdirectory = true;
    else if (kind === "archive") input.accept = ".zip,.tar,.tgz,.tar.gz";
    else {
      input.multiple = true;
      input.accept = "image/*,.heic,.heif,.dng,.cr2,.cr3,.nef,.arw,.raf,.orf,.rw2";
    }
    input.addEventListener("change", () => {
      const files = chosenFiles(input.files ?? []);
      input.value = "";
      if (files.size > 0) take(files).catch(fail);
    });
    return input;
  };
  const [folder, photographs, archive] = [chooser("folder"), chooser("photographs"), chooser("archive")];
  const area = h(
    "div",
    { class: "drop" },
    h("p", {}, scene === null ? texts.upload.drop : texts.upload.dropAgain),
    h("p", { class: "faint" }, texts.upload.hint),
    h(
      "div",
      { class: "actions" },
      h(
        "button",
        { type: "button", class: "first", onclick: () => photographs.click() },
        texts.upload.choosePhotographs,
      ),
      h("button", { type: "button", onclick: () => folder.click() }, texts.upload.chooseFolder),
      h("button", { type: "button", onclick: () => archive.click() }, texts.upload.chooseArchive),
    ),
    folder,
    photographs,
    archive,
  );
  area.addEventListener("dragover", (event) => {
    event.preventDefault();
    area.classList.add("over");
  });
  area.addEventListener("dragleave", () => area.classList.remove("over"));
  area.addEventListener("drop", (event) => {
    event.preventDefault();
    area.classList.remove("over");
    take(filesIn(droppedEntries(event.dataTransfer?.items ?? []))).catch(fail);
  });

  const list = h("ul", { class: "list", "aria-label": texts.upload.uploads });
  const rows = new WeakMap<Promise<unknown>, { element: HTMLElement; update: (one: Running) => void }>();
  const draw = () => {
    const shown = uploads.all().filter((one) => one.sceneId === (scene?.id ?? null));
    arrange(
      list,
      shown.map((one) => {
        const row = rows.get(one.done) ?? uploadRow(one);
        rows.set(one.done, row);
        row.update(one);
        return row.element;
      }),
    );
    list.hidden = shown.length === 0;
    area.hidden = scene !== null && shown.length > 0;
  };
  draw();
  return { element: h("div", { class: "upload" }, area, list), close: uploads.listen(draw) };
}

function uploadRow(one: Running): { element: HTMLElement; update: (one: Running) => void } {
  const bar = h("progress", {
    max: 1,
    value: 0,
    "aria-label": fillIn(texts.upload.uploadOf, { name: one.name }),
  });
  const text = h("p", { class: "figures" });
  const stop = h("button", { type: "button", onclick: one.stop }, texts.upload.stop);
  const element = h("li", { class: "card" }, h("h3", {}, one.name), bar, text, h("div", {}, stop));
  return {
    element,
    update: ({ step }) => {
      bar.value = step.totalBytes > 0 ? step.doneBytes / step.totalBytes : 0;
      setText(text, describe(step));
    },
  };
}

/** Upload a candidate, have the scene checked, and go to its page. */
export async function send(context: Context, candidate: Candidate, sceneId: string | null): Promise<void> {
  const { api, store, uploads } = context;
  let scene: Scene;
  try {
    scene = await uploads.begin(candidate, sceneId).done;
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") return;
    throw error;
  }
  const job = await api.submit({ scene_id: scene.id, kind: "check" }, `check-${scene.id}`);
  store.put(job);
  location.hash = sceneAddress(scene.id);
}
