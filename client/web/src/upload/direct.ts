/** Sends files directly to the server's store, by addresses that the server signs for each of them. */

import { type Api, type FileUpload, Refused, Unreachable } from "../page/rest.js";

export type DirectTools = {
  readonly api: Pick<Api, "offerUploads" | "completeUploads" | "putToStore">;
  readonly signal: AbortSignal;
};

/** Send one file; false where the server has to take it itself. */
export type DirectSend = (sha256: string, body: Blob) => Promise<boolean>;

const mostTries = 5;

/**
 * Return what sends the files of a scene; `offers` are the addresses that came with its plan.
 *
 * Throws Unreachable when the server or its store does not answer for now. A store that was never reached, perhaps
 * because it does not accept requests from pages of this site, is given up: the server then takes all files.
 */
export function directSender(id: string, offers: readonly FileUpload[], tools: DirectTools): DirectSend {
  const { api, signal } = tools;
  const first = new Map(offers.map((offer) => [offer.sha256, offer]));
  let reached = false;
  let givenUp = offers.length === 0;

  /** Send a part and return the status of the answer; null where the store was never reached from here. */
  async function put(part: FileUpload["parts"][number], body: Blob): Promise<number | null> {
    const piece = part.number === 0 ? body : body.slice(part.offset, part.offset + part.size_bytes);
    let status: number;
    try {
      status = await api.putToStore(part.url, part.headers, piece, signal);
    } catch (error) {
      if (error instanceof Unreachable && !reached) return null;
      throw error;
    }
    reached = true;
    if (status >= 500 || status === 429) throw new Unreachable(String(status));
    return status;
  }

  /** Send the parts of an offer; "expired" if its addresses do not work any more. */
  async function sendParts(offer: FileUpload, body: Blob): Promise<"sent" | "expired" | "none"> {
    for (const part of offer.parts) {
      const status = await put(part, body);
      if (status === null) return "none";
      if (status >= 300) return "expired";
    }
    return "sent";
  }

  async function send(sha256: string, body: Blob): Promise<boolean> {
    for (let tries = 1; ; tries += 1) {
      const offer = first.get(sha256) ?? (await api.offerUploads(id, [sha256])).items[0];
      first.delete(sha256);
      if (offer === undefined) return false;
      const outcome = await sendParts(offer, body);
      if (outcome === "none") {
        givenUp = true;
        return false;
      }
      if (outcome === "sent") {
        const refused = (await api.completeUploads(id, [sha256])).refused[0];
        if (refused === undefined) return true;
        if (tries >= mostTries) throw new Refused(409, refused.code, refused.detail, true);
      } else if (tries >= mostTries) {
        throw new Unreachable(outcome);
      }
    }
  }

  return async (sha256, body) => !givenUp && (await send(sha256, body));
}
