/** The lights of a viewer: their maps, and which of them are prepared and on the stage. */

import { LightClient } from "../light/client.js";
import type { MapOrigin } from "../light/lightWorker.js";
import { maxDominant } from "../light/prepare.js";
import type { Stage } from "../render/stage.js";
import { EarlyLight } from "./earlyLight.js";
import { mapOrigin } from "./mapOrigin.js";
import type { ViewerState } from "./state.js";

type Host = {
  readonly stage: () => Stage | null;
  readonly state: () => ViewerState;
  /** A light came onto the stage; `notes` are sentences about changes made to its map. */
  readonly lit: (notes: readonly string[]) => void;
};

export class ViewerLights {
  readonly #client = new LightClient();
  readonly #files = new Map<string, Uint8Array<ArrayBuffer>>();
  readonly #versions = new Map<string, number>();
  readonly #shown = new Map<"a" | "b", string>();
  readonly #addresses = new Set<string>();
  #early: EarlyLight | null = null;

  constructor(private readonly host: Host) {}

  /** Return what prepares the wanted light of a bundle while the rest of it is being read. */
  early(): EarlyLight {
    return new EarlyLight({
      wanted: () => this.host.state().environment,
      originOf: (name) => this.#origin(name),
      prepare: (origin, bands) => this.#client.prepare(origin, bands, maxDominant),
    });
  }

  /** Another bundle is on the stage: no light is any more. */
  forget(early: EarlyLight): void {
    this.#early = early;
    this.#shown.clear();
  }

  splitSum(): Promise<Float32Array<ArrayBuffer>> {
    return this.#client.splitSum();
  }

  /** Keep a map and return the name it has from now on. */
  addMap(name: string, data: Uint8Array<ArrayBuffer>): string {
    const light = `file:${name}`;
    this.#files.set(name, data);
    this.#versions.set(light, this.version(light) + 1);
    // A map that was changed on disk and dropped again is another one.
    for (const [slot, shown] of this.#shown) if (shown === light) this.#shown.delete(slot);
    return light;
  }

  get mapNames(): string[] {
    return [...this.#files.keys()];
  }

  /** The lights at addresses that were shown. */
  get addresses(): ReadonlySet<string> {
    return this.#addresses;
  }

  /** The bytes of a map that was dropped, or null. */
  file(name: string): Uint8Array<ArrayBuffer> | null {
    return this.#files.get(name) ?? null;
  }

  /** Return how often the map of a light was dropped. */
  version(light: string): number {
    return this.#versions.get(light) ?? 0;
  }

  /** Return a ball in a light, see `ballPicture`; throws MapFault. */
  async thumbnail(light: string, side: number): Promise<Uint8ClampedArray<ArrayBuffer>> {
    return this.#client.thumbnail(this.#origin(light), side);
  }

  /** Prepare the lights that the state names and that are not there yet; throws MapFault. */
  async apply(): Promise<void> {
    const { environment, environmentB, compare } = this.host.state();
    const wanted: ["a" | "b", string][] = [["a", environment]];
    if (compare === "environment") wanted.push(["b", environmentB]);
    else {
      this.host.stage()?.dropLight("b");
      this.#shown.delete("b");
    }
    await Promise.all(wanted.map(([slot, name]) => this.#apply(slot, name)));
  }

  dispose(): void {
    this.#client.dispose();
  }

  async #apply(slot: "a" | "b", name: string): Promise<void> {
    const stage = this.host.stage();
    const bundle = stage?.bundle;
    if (stage == null || bundle == null || this.#shown.get(slot) === name) return;
    this.#shown.set(slot, name);
    const { bands } = bundle.transport.direct;
    try {
      const prepared = await (this.#early?.take(name, bands) ??
        this.#client.prepare(this.#origin(name), bands, maxDominant));
      // Another light may have been chosen, or another bundle opened, in the meantime.
      if (this.#shown.get(slot) !== name || stage.bundle !== bundle) return;
      stage.setLight(slot, prepared);
      if (name.startsWith("url:")) this.#addresses.add(name);
      this.host.lit(prepared.notes);
    } catch (error) {
      // Ignore errors of a light that is no longer wanted.
      if (this.#shown.get(slot) !== name) return;
      this.#shown.delete(slot);
      throw error;
    }
  }

  #origin(name: string): MapOrigin {
    return mapOrigin(name, this.host.stage()?.bundle ?? null, this.#files);
  }
}
