/** The log of a job's run processes, loaded on demand. */

import { h, setText } from "../page/dom.js";
import { isFinal, type Job } from "../page/rest.js";
import type { Context } from "./view.js";
import { texts } from "../words/words.js";

const everyMs = 3000;

/** Return the section, closed at first; while it is open and the job runs it is kept current. */
export function logView({ api, fail }: Context, jobId: string) {
  const text = h("pre", { tabindex: 0, "aria-label": texts.job.log });
  const all = h(
    "a",
    { href: `/v1/jobs/${jobId}/log`, target: "_blank", rel: "noopener" },
    texts.job.wholeLog,
  );
  const details = h("details", {}, h("summary", {}, texts.job.log), text, h("p", {}, all));
  let ended = false;
  let timer: ReturnType<typeof setInterval> | undefined;

  async function load(): Promise<void> {
    const atEnd = text.scrollTop + text.clientHeight >= text.scrollHeight - 8;
    setText(text, (await api.log(jobId)) || texts.job.nothingYet);
    if (atEnd) text.scrollTop = text.scrollHeight;
  }
  const stop = () => clearInterval(timer);
  details.addEventListener("toggle", () => {
    stop();
    if (!details.open) return;
    load().catch(fail);
    // The header shows that the server does not answer; the next round tries again.
    if (!ended) timer = setInterval(() => void load().catch(() => {}), everyMs);
  });
  return {
    element: h("section", { "aria-label": texts.job.log }, details),
    update: (job: Job) => {
      if (ended || !isFinal(job)) return;
      ended = true;
      stop();
      if (details.open) load().catch(fail);
    },
    close: stop,
  };
}
