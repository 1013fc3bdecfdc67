/** The page that `lambent masks --edit` shows. */

import { explain } from "../page/actions.js";
import { h } from "../page/dom.js";
import type { Finished } from "./backend.js";
import { maskEditor } from "./editor.js";
import { keyOf, localBackend } from "./localBackend.js";

const main = document.querySelector<HTMLElement>("#main")!;
const message = document.querySelector<HTMLElement>("#message")!;

function fail(error: unknown): void {
  message.textContent = explain(error);
  message.hidden = false;
}

function recovered(): void {
  message.hidden = true;
}

function finished({ told: text, command }: Finished): void {
  main.replaceChildren(
    h("h1", { tabindex: -1 }, "Done"),
    h("p", { role: "status" }, text),
    h("p", {}, "When it says so, go on in the terminal with:"),
    h("pre", { tabindex: 0 }, h("code", {}, command ?? "")),
  );
  main.querySelector("h1")?.focus();
}

async function run(): Promise<void> {
  const key = keyOf(location.hash);
  if (key === null) throw new Error("This address is incomplete. Open the one that the command printed.");
  const backend = localBackend(key);
  const editor = await maskEditor({ backend, fail, recovered, finished, finishLabel: "Done" });
  main.replaceChildren(h("h1", { tabindex: -1 }, "Correct the masks"), editor.element);
}

run().catch((error) => {
  main.replaceChildren();
  fail(error);
});
