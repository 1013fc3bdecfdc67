/** What a browser sees that is not logged in: the way in, and nothing that would only be refused. */

import { h } from "../page/dom.js";
import { type Api, Refused } from "../page/rest.js";
import type { View } from "./view.js";

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
  const link = h("input", { id: "link", name: "link", autocomplete: "off", spellcheck: "false" });
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
    problem.textContent =
      code === null
        ? "That is no login link: it ends in #code= and letters."
        : "This link was used before, or has expired. Ask for a new one.";
    problem.hidden = false;
    link.focus();
  }

  const submit = (event: SubmitEvent): void => {
    event.preventDefault();
    enter().catch(fail);
  };
  return {
    title: "Log in",
    element: h(
      "div",
      { class: "locked" },
      h("h1", { tabindex: -1 }, "Log in"),
      h("p", {}, "This browser is not logged in to this server."),
      h(
        "form",
        { onsubmit: submit },
        h("label", { for: "link" }, "One-time link"),
        link,
        h("button", { class: "first" }, "Log in"),
      ),
      problem,
      h(
        "p",
        { class: "faint" },
        "The server prints a link when it starts, and makes another one with ",
        h("code", {}, "POST /v1/login-links"),
        ". Each logs one browser in, once.",
      ),
    ),
  };
}
