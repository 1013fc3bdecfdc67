/** What a browser sees that is not logged in: the way in, and nothing that would only be refused. */

import { h } from "../page/dom.js";
import { type Api, Refused } from "../page/rest.js";
import type { View } from "./view.js";
import { texts } from "../words/words.js";

/** Return the code in a one-time link, or in what was copied of it; null where there is none. */
export function codeIn(text: string): string | null {
  const given = text.trim();
  const code = given.includes("code=") ? given.split("code=").at(-1)!.split("&")[0]! : given;
  return /^[\w-]{8,200}$/.test(code) ? code : null;
}

/** Return the view; `loggedIn` is called once the server has let this browser in. */
export function lockedView(
  api: Pick<Api, "logIn">,
  fail: (error: unknown) => void,
  loggedIn: () => void,
): View {
  const link = h("input", {
    type: "text",
    id: "link",
    name: "link",
    autocomplete: "off",
    spellcheck: "false",
  });
  const problem = h("p", { class: "notice bad", role: "alert", hidden: true });

  async function enter(): Promise<void> {
    const code = codeIn(link.value);
    try {
      if (code !== null) {
        await api.logIn(code);
        loggedIn();
        return;
      }
    } catch (error) {
      if (!(error instanceof Refused) || error.status >= 500) throw error;
    }
    problem.textContent = code === null ? texts.locked.noLink : texts.locked.used;
    problem.hidden = false;
    link.focus();
  }

  const submit = (event: SubmitEvent): void => {
    event.preventDefault();
    enter().catch(fail);
  };
  return {
    title: texts.locked.title,
    element: h(
      "div",
      { class: "locked" },
      h("h1", { tabindex: -1 }, texts.locked.title),
      h("p", {}, texts.locked.notLoggedIn),
      h(
        "form",
        { onsubmit: submit },
        h("label", { for: "link" }, texts.locked.link),
        link,
        h("button", { class: "first" }, texts.locked.logIn),
      ),
      problem,
      h(
        "p",
        { class: "faint" },
        texts.locked.helpBefore,
        h("code", {}, "POST /v1/login-links"),
        texts.locked.helpAfter,
      ),
    ),
  };
}
