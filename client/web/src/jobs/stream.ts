/** Server-sent events by a fetch reader: unlike EventSource it says why it failed, and continues by header. */

import { type Api, pause, Refused } from "../page/rest.js";

/** One message of the stream. */
export type StreamMessage = { readonly event: string; readonly id: string; readonly data: string };

/** The server sends a comment every 15 s; a connection that is quiet for this long is dead. */
const silenceMs = 40_000;
/** A timer this late means that the machine has slept, and that the connection is dead. */
const sleepMs = 15_000;
const tickMs = 5_000;
const firstPauseMs = 500;
const longestPauseMs = 10_000;
/** Proxies accept a Last-Event-ID of this length; a longer one is dropped, and snapshots begin anew. */
const longestId = 7_900;

/** Return the messages in `text`, and what is left of one that is not complete. */
export function parse(text: string): { messages: StreamMessage[]; rest: string } {
  const blocks = text.split("\n\n");
  const rest = blocks.pop() ?? "";
  const messages: StreamMessage[] = [];
  for (const block of blocks) {
    const found = { event: "message", id: "", data: "" };
    for (const line of block.split("\n")) {
      const colon = line.indexOf(": ");
      const name = line.slice(0, colon);
      if (name === "event" || name === "id" || name === "data") found[name] = line.slice(colon + 2);
    }
    if (found.data !== "") messages.push(found);
  }
  return { messages, rest };
}

export type Following = {
  readonly api: Pick<Api, "stream">;
  readonly onMessage: (message: StreamMessage) => void;
  /** Called with false when the server does not answer, and with true when it answers again. */
  readonly onConnection: (connected: boolean) => void;
  /** Ends the following. */
  readonly signal: AbortSignal;
};

/**
 * Follow all jobs until `signal`; after a break it continues after the last message, without gap or
 * repetition.
 * The clock tells when a sleeping machine has lost its connection, which is then opened anew. Throws Refused with
 * status 401 where this browser is not logged in.
 */
export async function follow({ api, onMessage, onConnection, signal }: Following): Promise<void> {
  let last = "";
  let pauseMs = firstPauseMs;
  while (!signal.aborted) {
    const connection = new Connection(signal);
    try {
      const response = await api.stream(last, connection.signal);
      onConnection(true);
      let text = "";
      for await (const piece of connection.read(response)) {
        pauseMs = firstPauseMs;
        const { messages, rest } = parse(text + piece);
        text = rest;
        for (const message of messages) {
          // Of many snapshots only the last one has an id.
          if (message.id !== "") last = message.id.length > longestId ? "" : message.id;
          onMessage(message);
        }
      }
    } catch (error) {
      if (error instanceof Refused && error.status === 401) throw error;
      // Positions that the server cannot use (any more): begin with snapshots.
      if (error instanceof Refused && error.status < 500 && error.status !== 429) last = "";
    } finally {
      connection.close();
    }
    if (signal.aborted) return;
    onConnection(false);
    await pause(connection.slept ? 0 : pauseMs, signal);
    pauseMs = Math.min(2 * pauseMs, longestPauseMs);
  }
}

/** One connection, which ends itself when nothing more can arrive. */
class Connection {
  readonly #controller = new AbortController();
  readonly #timer: ReturnType<typeof setInterval>;
  #heardAt = Date.now();
  #tickAt = Date.now();
  /** Whether the machine has slept meanwhile. */
  slept = false;
  readonly signal: AbortSignal;

  constructor(outer: AbortSignal) {
    this.signal = AbortSignal.any([outer, this.#controller.signal]);
    this.#timer = setInterval(() => this.#look(), tickMs);
  }

  #look(): void {
    const now = Date.now();
    this.slept = now - this.#tickAt > sleepMs;
    this.#tickAt = now;
    if (this.slept || now - this.#heardAt > silenceMs) this.#controller.abort();
  }

  async *read(response: Response): AsyncGenerator<string> {
    if (response.body === null) return;
    const decoder = new TextDecoder();
    const reader = response.body.getReader();
    // A stream that fetch did not open does not know the signal.
    this.signal.addEventListener("abort", () => void reader.cancel().catch(() => {}), { once: true });
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      this.#heardAt = Date.now();
      yield decoder.decode(value, { stream: true });
    }
  }

  close(): void {
    clearInterval(this.#timer);
    this.#controller.abort();
  }
}
