// Server-sent events by a fetch reader: unlike EventSource it says why it failed and continues by header.

/**
 * @typedef {object} StreamMessage
 * @property {string} event
 * @property {string} id
 * @property {string} data
 */

/**
 * Return the messages in `text`, and what is left of one that is not complete.
 * @param {string} text
 * @returns {{ messages: StreamMessage[], rest: string }}
 */
export function parse(text) {
  const blocks = text.split("\n\n");
  const rest = blocks.pop() ?? "";
  /** @type {StreamMessage[]} */
  const messages = [];
  for (const block of blocks) {
    const message = { event: "message", id: "", data: "" };
    for (const line of block.split("\n")) {
      const colon = line.indexOf(": ");
      const value = line.slice(colon + 2);
      if (line.startsWith("event: ")) message.event = value;
      if (line.startsWith("id: ")) message.id = value;
      if (line.startsWith("data: ")) message.data = value;
    }
    if (message.data !== "") messages.push(message);
  }
  return { messages, rest };
}

/** The server does not know this browser (any more). */
export class NotLoggedIn extends Error {}

/**
 * Follow all jobs for as long as the page lives; after a break it goes on where it was.
 * @param {(message: StreamMessage) => void} onMessage
 * @param {(connected: boolean) => void} onConnection
 * @returns {Promise<never>}
 */
export async function follow(onMessage, onConnection) {
  let last = "";
  let waitMs = 500;
  for (;;) {
    try {
      const response = await fetch("/v1/events", { headers: last ? { "Last-Event-ID": last } : {} });
      if (response.status === 401) throw new NotLoggedIn();
      if (!response.ok || response.body === null) throw new Error(`events: ${response.status}`);
      onConnection(true);
      const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
      let text = "";
      for (;;) {
        const { done, value } = await reader.read();
        if (done) break;
        waitMs = 500;
        const { messages, rest } = parse(text + value);
        text = rest;
        for (const message of messages) {
          last = message.id;
          onMessage(message);
        }
      }
    } catch (error) {
      if (error instanceof NotLoggedIn) throw error;
    }
    onConnection(false);
    await new Promise((resolve) => setTimeout(resolve, waitMs));
    waitMs = Math.min(2 * waitMs, 10_000);
  }
}
