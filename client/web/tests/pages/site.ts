/** Another site, for tests of what it shows of ours. */

import { once } from "node:events";
import { createServer, type Server } from "node:http";
import type { AddressInfo } from "node:net";

/** Its pages by their addresses, and the headers that all of them have. */
export class Site {
  readonly pages = new Map<string, string>();
  headers: Record<string, string> = {};
  #server: Server | null = null;
  origin = "";

  async start(): Promise<void> {
    this.#server = createServer((request, response) => {
      const page = request.url === "/favicon.ico" ? "" : this.pages.get(request.url ?? "");
      response.writeHead(page === undefined ? 404 : 200, { "content-type": "text/html", ...this.headers });
      response.end(`<!doctype html><title>A shop</title><body style="margin:0">${page ?? ""}`);
    }).listen(0, "127.0.0.1");
    await once(this.#server, "listening");
    // Another site than 127.0.0.1, as far as cookies are concerned.
    this.origin = `http://localhost:${(this.#server.address() as AddressInfo).port}`;
  }

  close(): void {
    this.#server?.close();
  }
}
