/** The header of the page: who has signed in for which organisation, and what the operators announce. */

import { h } from "../page/dom.js";
import type { Api, Me, Schemas } from "../page/rest.js";
import { texts } from "../words/words.js";

/** Return the name of a user, and a choice of organisations; nothing for a one-time link. */
function accountParts(me: Me, choose: (organisation: string) => void): readonly (Node | string)[] {
  if (me.user_id === null) return [];
  if (me.organisations.length < 2) return [`${me.name} · ${me.organisation_name}`];
  const select = h(
    "select",
    { "aria-label": texts.locked.organisation, onchange: () => choose(select.value) },
    ...me.organisations.map((each) =>
      h("option", { value: each.id, selected: each.id === me.organisation }, each.name),
    ),
  );
  return [`${me.name} · `, select];
}

/** Fill an element; `switched` is called once the server has changed to another organisation. */
export async function showAccount(
  element: HTMLElement,
  { api, fail }: { readonly api: Pick<Api, "me" | "switchTo">; readonly fail: (error: unknown) => void },
  switched: () => void,
): Promise<void> {
  const choose = (organisation: string): void => {
    api.switchTo(organisation).then(switched).catch(fail);
  };
  element.replaceChildren(...accountParts(await api.me(), choose));
}

/** Return the notice to show, the operators' own words last; "" if there is none. */
export function noticeText({ maintenance, drain }: Schemas["Notices"]): string {
  const told = maintenance ?? drain;
  if (told === null) return "";
  const sentence = maintenance === null ? texts.notices.drain : texts.notices.maintenance;
  return `${sentence} ${told.message}`.trim();
}
