/** The light of a bundle, prepared while the rest of the bundle is still being read. */

import type { BundleNews } from "../bundle/load.js";
import type { MapOrigin } from "../light/lightWorker.js";
import type { PreparedLight } from "../light/prepare.js";
import { initialState } from "./state.js";

/** Return the light to show: the wanted one where the bundle has it, its first one, or a preset. */
export function lightFor(wanted: string, trained: readonly string[]): string {
  const known = wanted !== "" && (!wanted.startsWith("trained:") || trained.includes(wanted.slice(8)));
  if (known) return wanted;
  return trained[0] === undefined ? initialState.environment : `trained:${trained[0]}`;
}

type Host = {
  /** The light that is wanted now. */
  readonly wanted: () => string;
  /** Returns the source of a light that is not the bundle's; throws if there is none. */
  readonly originOf: (name: string) => MapOrigin;
  readonly prepare: (origin: MapOrigin, bands: number) => Promise<PreparedLight>;
};

/** Listens to the reading of one bundle. */
export class EarlyLight {
  #name = "";
  #bands = 0;
  #light: Promise<PreparedLight> | null = null;

  constructor(private readonly host: Host) {}

  /** Begin as soon as enough is known. */
  hear(news: BundleNews): void {
    if (news.kind === "opened") {
      this.#name = lightFor(this.host.wanted(), news.lights);
      this.#bands = news.bands;
      if (!this.#name.startsWith("trained:")) this.#begin(() => this.host.originOf(this.#name));
    } else if (news.kind === "map" && this.#name === `trained:${news.map.name}`) {
      this.#begin(() => ({ kind: "bytes", data: news.map.data }));
    }
  }

  /** Return the light whose preparation was started, once, or null. */
  take(name: string, bands: number): Promise<PreparedLight> | null {
    const fits = this.#name === name && this.#bands === bands;
    const light = fits ? this.#light : null;
    this.#light = null;
    return light;
  }

  #begin(origin: () => MapOrigin): void {
    // Planes of other sizes are refused when they have been read.
    if (!(this.#bands >= 1 && this.#bands <= 9)) return;
    try {
      this.#light = this.host.prepare(origin(), this.#bands);
      // The caller that takes it handles a failure.
      this.#light.catch(() => {});
    } catch {
      // Reported when the light is requested again.
      this.#light = null;
    }
  }
}
