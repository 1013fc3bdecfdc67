/** What the operators of the server have told everybody. */

import type { Schemas } from "../page/rest.js";
import { texts } from "../words/words.js";

/** Return the sentences to show, the operators' own words last; "" if there is nothing to say. */
export function noticeText({ maintenance, drain }: Schemas["Notices"]): string {
  const told = maintenance ?? drain;
  if (told === null) return "";
  const sentence = maintenance === null ? texts.notices.drain : texts.notices.maintenance;
  return `${sentence} ${told.message}`.trim();
}
