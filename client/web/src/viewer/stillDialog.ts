/** The dialog that refines a picture to save; loaded when it is first needed. */

import { dialogSheet, WorkNews } from "./dialogs.js";
import { button, make } from "./fields.js";
import { download } from "./save.js";
import type { Viewer } from "./viewer.js";
import { statusText } from "../refine/status.js";
import { refinedFile } from "./stillFile.js";
import { fillIn, texts } from "../words/words.js";

/** Refine a picture and offer it as a file, with its progress in a dialog in `root`; resolves when that is closed. */
export async function saveRefined(
  root: ShadowRoot,
  viewer: Viewer,
  size: { readonly width: number; readonly height: number },
  kind: "png" | "exr",
): Promise<void> {
  const stop = new AbortController();
  const bar = make("progress", { ariaLabel: texts.refine.parts });
  const told = new WorkNews();
  told.say(texts.refine.starting);
  const cancel = button(texts.page.cancel, () => stop.abort(new DOMException("cancelled", "AbortError")));
  const heading = make("h2", {
    textContent: fillIn(texts.refine.heading, { width: size.width, height: size.height }),
  });
  const element = make("dialog", { className: "work" }, heading, bar, told.count, told.news, cancel);
  element.setAttribute("aria-label", texts.refine.dialog);
  element.addEventListener("cancel", (event) => {
    event.preventDefault();
    cancel.click();
  });
  if (!root.adoptedStyleSheets.includes(dialogSheet())) root.adoptedStyleSheets.push(dialogSheet());
  root.append(element);
  element.showModal();
  try {
    const blob = await refinedFile(viewer, size, kind, {
      signal: stop.signal,
      onProgress: (part, parts, status) => {
        const made = part - (status.phase === "done" ? 0 : 1);
        Object.assign(bar, { max: parts, value: made });
        told.reach(made / parts, fillIn(texts.refine.part, { part, parts, status: statusText(status) }));
      },
    });
    download(blob, `${viewer.bundle?.name ?? "lambent"}.${kind}`);
  } catch (error) {
    if (!stop.signal.aborted) throw error;
  } finally {
    // Closing it gives the focus back.
    element.close();
    element.remove();
  }
}
