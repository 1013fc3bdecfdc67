/** Who has signed in, and the organisation whose things the page shows. */

import { h } from "../page/dom.js";
import type { Api, Me } from "../page/rest.js";
import { texts } from "../words/words.js";

/** Return what to show of somebody; nothing where a one-time link was opened. */
export function accountParts(me: Me, choose: (organisation: string) => void): readonly (Node | string)[] {
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

/** Fill an element; `switched` is called once the server goes on with another organisation. */
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
