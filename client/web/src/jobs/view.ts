/** The interface between the page and its views. */

import { h } from "../page/dom.js";
import { formatSize } from "../page/format.js";
import type { Api, Scene } from "../page/rest.js";
import type { Removals } from "../page/removals.js";
import type { Uploads } from "../upload/uploads.js";
import type { JobStore } from "./store.js";
import { fillIn, named, texts } from "../words/words.js";

export type Context = {
  readonly api: Api;
  readonly store: JobStore;
  readonly uploads: Uploads;
  readonly removals: Removals;
  /** Report a problem with an action of the visitor. */
  readonly fail: (error: unknown) => void;
};

/** One place of the page. */
export type View = {
  readonly title: string;
  readonly element: HTMLElement;
  /** A job has changed; null: the connection was restored. */
  readonly update?: (jobId: string | null) => void;
  readonly close?: () => void;
};

/** Return the number and size of a scene's files, to be followed by a time; empty where there are none. */
export function sizeText({ num_files: n, size_bytes }: Scene): string {
  return n > 0 ? `${fillIn(texts.page.files, { n })}, ${formatSize(size_bytes)} · ` : "";
}

/** Return a label for a state, with the name that people use. */
export function stateLabel(state: string): HTMLElement {
  return h("span", { class: "state", "data-state": state }, named(texts.states, state));
}
