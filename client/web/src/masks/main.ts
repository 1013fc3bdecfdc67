/** The page that `lambent masks --edit` shows. */

import { explain } from "../page/actions.js";
import { h } from "../page/dom.js";
import { maskEditor } from "./editor.js";
import { keyOf, localBackend } from "./localBackend.js";
import { speakAsBrowser, texts } from "../words/words.js";

await speakAsBrowser();
const main = document.querySelector<HTMLElement>("#main")!;
const message = document.querySelector<HTMLElement>("#message")!;

document.title = `${texts.masks.title} · Lambent`;
main.querySelector("[role=status]")!.textContent = texts.masks.loading;

function fail(error: unknown): void {
  message.textContent = explain(error);
  message.hidden = false;
}

function recovered(): void {
  message.hidden = true;
}

function finished(command: string): void {
  main.replaceChildren(
    h("h1", { tabindex: -1 }, texts.masks.done),
    h("p", { role: "status" }, texts.masks.toldLocal),
    h("p", {}, texts.masks.goOn),
    h("pre", { tabindex: 0 }, h("code", {}, command)),
  );
  main.querySelector("h1")?.focus();
}

async function run(): Promise<void> {
  const key = keyOf(location.hash);
  if (key === null) throw new Error(texts.masks.incomplete);
  const backend = localBackend(key);
  const editor = await maskEditor({ backend, fail, recovered, finished, finishLabel: texts.masks.done });
  main.replaceChildren(h("h1", { tabindex: -1 }, texts.masks.title), editor.element);
}

run().catch((error) => {
  main.replaceChildren();
  fail(error);
});
