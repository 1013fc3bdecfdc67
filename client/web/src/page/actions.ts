/** Buttons that send a request to the server, and the messages for refused requests. */

import { h } from "./dom.js";
import { messageOf } from "./fault.js";
import { Refused, Unreachable } from "./rest.js";
import { texts } from "../words/words.js";

/** Return the message for an error. */
export function explain(error: unknown): string {
  if (error instanceof Unreachable) return texts.page.noServer;
  if (error instanceof Refused && error.status === 401) {
    return texts.page.notLoggedIn;
  }
  if (error instanceof Refused) {
    const details = error.errors
      .slice(0, 5)
      .map((each) => `${each.pointer.replace(/^#\/?/, "")}: ${each.message}`);
    return [error.message, ...details].join("\n");
  }
  return messageOf(error);
}

/** Return a button that is disabled while its action is running. */
export function button(
  text: string,
  { fail, className = null }: { readonly fail: (error: unknown) => void; readonly className?: string | null },
  action: () => Promise<void>,
): HTMLButtonElement {
  const element = h("button", { type: "button", class: className }, text);
  element.addEventListener("click", () => {
    element.disabled = true;
    action()
      .catch(fail)
      .finally(() => {
        element.disabled = false;
      });
  });
  return element;
}
