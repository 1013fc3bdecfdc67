/** The interface between the page and its views. */

import { h } from "../page/dom.js";
import type { Api } from "../page/rest.js";
import type { Removals } from "../page/removals.js";
import type { Uploads } from "../upload/uploads.js";
import type { JobStore } from "./store.js";
import { named, texts } from "../words/words.js";

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
  /** A job has changed; without an id the connection has come back. */
  readonly update?: (jobId: string | null) => void;
  readonly close?: () => void;
};

/** Return a paragraph for a state, with the name that people use. */
export function stateLabel(state: string): HTMLElement {
  return h("span", { class: "state", "data-state": state }, named(texts.states, state));
}
