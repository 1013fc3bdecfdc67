/** The view of a browser that is not logged in: the ways to log in, and nothing that would be refused. */

import { h } from "../page/dom.js";
import { type Api, Refused } from "../page/rest.js";
import type { View } from "./view.js";
import { texts } from "../words/words.js";

/** Return the code in a one-time link, or in a part of one; null where there is none. */
export function codeIn(text: string): string | null {
  const given = text.trim();
  const code = given.includes("code=") ? given.split("code=").at(-1)!.split("&")[0]! : given;
  return /^[\w-]{8,200}$/.test(code) ? code : null;
}

/** Return the message for a failed sign-in that the address names; null where it names none. */
export function failedSignIn(hash: string): string | null {
  const code = new URLSearchParams(hash.slice(1)).get("sign-in");
  if (code === null) return null;
  return code === "sign_in_refused" ? texts.locked.signInRefused : texts.locked.signInFailed;
}

/** Return the link to where people sign in, or null where the server has none. */
async function signInLink(api: Pick<Api, "version">): Promise<HTMLElement | null> {
  const { sign_in_url: address } = await api.version();
  if (address === null || !address.startsWith("/")) return null;
  return h(
    "div",
    {},
    h("p", {}, h("a", { href: address, class: "button first" }, texts.locked.signIn)),
    h("p", {}, texts.locked.orLink),
  );
}

/** Return the view; `loggedIn` is called once the server has let this browser in. */
export function lockedView(
  api: Pick<Api, "logIn" | "version">,
  fail: (error: unknown) => void,
  loggedIn: () => void,
  failed: string | null = null,
): View {
  const link = h("input", {
    type: "text",
    id: "link",
    name: "link",
    autocomplete: "off",
    spellcheck: "false",
  });
  const problem = h("p", { class: "notice bad", role: "alert", hidden: failed === null }, failed);
  const people = h("div");
  signInLink(api)
    .then((element) => element !== null && people.append(element))
    .catch(fail);

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
      people,
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
