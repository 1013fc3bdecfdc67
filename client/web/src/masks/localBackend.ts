/** The backend behind `lambent masks --edit`: a command on this machine. */

import { requireOk } from "../page/rest.js";
import type { Applied, Capture, MaskBackend } from "./backend.js";
import type { CorrectionList } from "./corrections.js";
import { texts } from "../words/words.js";

/** Return the key in the address of the page, or null where there is none. */
export function keyOf(fragment: string): string | null {
  return new URLSearchParams(fragment.replace(/^#/, "")).get("key") || null;
}

/** Return the backend behind a key; `send` is `fetch`, or its replacement in tests. */
export function localBackend(key: string, send: typeof fetch = (...given) => fetch(...given)): MaskBackend {
  const base = `/edit/${encodeURIComponent(key)}`;

  async function ask(path: string, init: RequestInit = {}): Promise<Response> {
    let response: Response;
    try {
      response = await send(`${base}/${path}`, init);
    } catch (error) {
      if (init.signal?.aborted) throw error;
      throw new Error(texts.masks.ended);
    }
    return requireOk(response);
  }

  const post = (path: string, corrections: CorrectionList, signal: AbortSignal | null = null) =>
    ask(path, {
      method: "POST",
      headers: { "content-type": "application/json" },
      body: JSON.stringify(corrections),
      signal,
    });
  const named = (frame: string) => `frame=${encodeURIComponent(frame)}`;

  return {
    load: async () => (await (await ask("capture")).json()) as Capture,
    picture: async (frame, side) => (await ask(`picture?${named(frame)}&side=${Math.round(side)}`)).blob(),
    mask: async (frame) => (await ask(`mask?${named(frame)}`)).blob(),
    apply: async (corrections, signal) =>
      (await (await post("corrections", corrections, signal)).json()) as Applied,
    finish: async (corrections) => {
      const { command } = (await (await post("finish", corrections)).json()) as { command: string };
      return command;
    },
  };
}
