/** Asks the light worker. */

import { Questions, startWorker, type Unnumbered } from "../page/workers.js";
import workerUrl from "./lightWorker.ts?worker&url";
import { MapFault } from "../page/fault.js";
import type { LightAnswer, LightQuestion, MapOrigin } from "./lightWorker.js";
import type { PreparedLight } from "./prepare.js";

/** One worker; questions are answered in order. */
export class LightClient {
  readonly #questions = new Questions<LightQuestion, LightAnswer>(startWorker(workerUrl));

  /** Decode and prepare a map for transport of `bands` bands; throws MapFault. */
  async prepare(origin: MapOrigin, bands: number, dominant: number): Promise<PreparedLight> {
    const answer = await this.#ask({ ask: "light", origin, bands, dominant });
    if (answer.kind !== "light") throw new Error("another answer than was asked for");
    return answer.light;
  }

  /** Return a ball in a light, see `ballPicture`; throws MapFault. */
  async thumbnail(origin: MapOrigin, side: number): Promise<Uint8ClampedArray<ArrayBuffer>> {
    const answer = await this.#ask({ ask: "thumbnail", origin, side });
    if (answer.kind !== "thumbnail") throw new Error("another answer than was asked for");
    return answer.pixels;
  }

  /** Compute the split-sum table. */
  async splitSum(): Promise<Float32Array<ArrayBuffer>> {
    const answer = await this.#ask({ ask: "splitSum" });
    if (answer.kind !== "splitSum") throw new Error("another answer than was asked for");
    return answer.table;
  }

  dispose(): void {
    this.#questions.close();
  }

  async #ask(question: Unnumbered<LightQuestion>): Promise<LightAnswer> {
    const answer = await this.#questions.ask(question);
    if (answer.kind === "failed") throw new MapFault(answer.code, answer.message);
    return answer;
  }
}
