/** The filter of a list of jobs: as an address, as parameters of a request, and applied to one job. */

import { isFinal, type Job } from "../page/rest.js";
import { texts } from "../words/words.js";

export type JobQuery = {
  /** Part of the name of the scene, or how the id or the preset begins. */
  readonly words: string;
  /** A key of `stateChoices`. */
  readonly state: string;
  /** A key of `kindChoices`. */
  readonly kind: string;
  readonly oldestFirst: boolean;
};

type Choice = { readonly text: () => string; readonly values: readonly string[] };

/** Kinds that lists show: checks belong to their scene. */
const listed: readonly string[] = ["train", "prepare", "bake", "render", "batch"];
/** The choices; the empty one is everything. */
export const stateChoices: ReadonlyMap<string, Choice> = new Map([
  ["", { text: () => texts.jobs.anyState, values: [] }],
  ["active", { text: () => texts.jobs.active, values: ["queued", "running", "cancelling", "retry_wait"] }],
  ["succeeded", { text: () => texts.states.succeeded, values: ["succeeded"] }],
  ["failed", { text: () => texts.states.failed, values: ["failed"] }],
  ["cancelled", { text: () => texts.states.cancelled, values: ["cancelled"] }],
]);
export const kindChoices: ReadonlyMap<string, Choice> = new Map([
  ["", { text: () => texts.jobs.anyKind, values: listed }],
  ["train", { text: () => texts.jobs.trainings, values: ["train"] }],
  ["prepare", { text: () => texts.jobs.preparations, values: ["prepare"] }],
  ["bake", { text: () => texts.jobs.bakes, values: ["bake"] }],
  ["pictures", { text: () => texts.jobs.pictures, values: ["render", "batch"] }],
]);
export const everything: JobQuery = { words: "", state: "", kind: "", oldestFirst: false };

/** Return the query in a fragment such as "#/?q=cup&state=failed"; unknown values are left out. */
export function queryOf(fragment: string): JobQuery {
  const given = new URLSearchParams(/^#\/\?(.*)$/s.exec(fragment)?.[1] ?? "");
  const known = (name: string, choices: ReadonlyMap<string, Choice>) => {
    const value = given.get(name) ?? "";
    return choices.has(value) ? value : "";
  };
  return {
    words: (given.get("q") ?? "").slice(0, 100),
    state: known("state", stateChoices),
    kind: known("kind", kindChoices),
    oldestFirst: given.get("sort") === "oldest",
  };
}

/** Return the fragment that leads back to a query. */
export function fragmentOf(query: JobQuery): string {
  const given = new URLSearchParams();
  if (query.words !== "") given.set("q", query.words);
  if (query.state !== "") given.set("state", query.state);
  if (query.kind !== "") given.set("kind", query.kind);
  if (query.oldestFirst) given.set("sort", "oldest");
  return given.size === 0 ? "#/" : `#/?${given}`;
}

/** Return the query as parameters of a request. */
export function parametersOf(query: JobQuery): URLSearchParams {
  const asked = new URLSearchParams();
  if (query.words.trim() !== "") asked.set("q", query.words.trim());
  for (const state of stateChoices.get(query.state)!.values) asked.append("state", state);
  for (const kind of kindChoices.get(query.kind)!.values) asked.append("kind", kind);
  if (query.oldestFirst) asked.set("sort", "oldest");
  return asked;
}

/** Return whether a job belongs into the list, as the server would say. */
export function matches(query: JobQuery, job: Job): boolean {
  const { values: kinds } = kindChoices.get(query.kind)!;
  if (!kinds.includes(job.kind)) return false;
  // Corrections belong to the editor of masks.
  if (job.kind === "prepare" && job.params.corrections !== undefined) return false;
  const { values: states } = stateChoices.get(query.state)!;
  // A state that this page does not know has not ended.
  if (query.state === "active" ? isFinal(job) : states.length > 0 && !states.includes(job.state))
    return false;
  const words = query.words.trim();
  if (words === "") return true;
  const named = job.scene_name.toLowerCase().includes(words.toLowerCase());
  return named || job.id.startsWith(words) || job.preset.startsWith(words);
}
