/** A real `lambent serve` for tests in a browser; it can be killed and started again. */

import { type ChildProcess, spawn } from "node:child_process";
import { once } from "node:events";
import { mkdtempSync, openSync, readFileSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { python, root } from "../support/checkout.js";

/** Short time-outs, as tests/support/live_server.py has them. */
const settings = {
  LAMBENT_TICK_S: "0.05",
  LAMBENT_HEARTBEAT_S: "0.2",
  LAMBENT_LOST_AFTER_S: "60",
  LAMBENT_STOP_GRACE_S: "2",
  LAMBENT_RETRY_DELAY_S: "0.1",
  LAMBENT_PROGRESS_INTERVAL_S: "0.1",
  LAMBENT_PREVIEW_INTERVAL_S: "0.2",
  LAMBENT_STREAM_POLL_S: "0.2",
  LAMBENT_STREAM_PING_S: "0.5",
  LAMBENT_LOCAL_SLOTS: "4",
  LAMBENT_LOCAL_GPUS: "0",
  LAMBENT_DISK_FLOOR_BYTES: "0",
};

export class JobServer {
  readonly #folder = mkdtempSync(join(tmpdir(), "lambent-pages-"));
  readonly #environment: NodeJS.ProcessEnv;
  #process: ChildProcess | null = null;
  #port = "0";
  #starts = 0;
  url = "";
  /** Logs one browser in, once. */
  link = "";

  /** With `sleeper` jobs only count steps; without it they train. */
  constructor(sleeper: boolean) {
    const trainer = JSON.stringify([python, join(root, "tests/support/sleep_trainer.py"), "run"]);
    this.#environment = {
      ...process.env,
      ...settings,
      ...(sleeper ? { LAMBENT_RUN_COMMAND: trainer } : {}),
    };
  }

  async start(): Promise<void> {
    this.#starts += 1;
    const data = join(this.#folder, "data");
    const log = openSync(join(this.#folder, `server-${this.#starts}.log`), "w");
    const serving = spawn(python, ["-m", "lambent", "serve", "--data", data, "--port", this.#port], {
      cwd: root,
      env: this.#environment,
      stdio: ["ignore", "pipe", log],
    });
    this.#process = serving;
    let text = "";
    serving.stdout?.on("data", (piece) => {
      text += piece;
    });
    for (let tries = 0; !text.includes("Key for programs"); tries++) {
      if (serving.exitCode !== null || tries > 1200) {
        throw new Error(readFileSync(join(this.#folder, `server-${this.#starts}.log`), "utf8"));
      }
      await new Promise((done) => setTimeout(done, 50));
    }
    this.url = /serves (\S+)/.exec(text)![1]!;
    this.link = /Open \(once\): (\S+)/.exec(text)![1]!;
    this.#port = new URL(this.url).port;
  }

  /** End the server as a power cut would; its runs continue. */
  async kill(): Promise<void> {
    await this.#end("SIGKILL");
  }

  /** End the server and its runs, and forget everything. */
  async close(): Promise<void> {
    await this.#end("SIGINT");
    rmSync(this.#folder, { recursive: true, force: true });
  }

  async #end(signal: NodeJS.Signals): Promise<void> {
    const serving = this.#process;
    if (serving === null || serving.exitCode !== null || serving.signalCode !== null) return;
    serving.kill(signal);
    await once(serving, "exit");
  }

  /** Ask as a program does, with the key. */
  async ask<T>(method: string, path: string, body?: unknown): Promise<T> {
    const key = readFileSync(join(this.#folder, "data/api.key"), "utf8").trim();
    const response = await fetch(`${this.url}${path}`, {
      method,
      headers: { authorization: `Bearer ${key}`, "content-type": "application/json" },
      ...(body === undefined ? {} : { body: JSON.stringify(body) }),
    });
    if (!response.ok) throw new Error(`${method} ${path}: ${response.status} ${await response.text()}`);
    return (await response.json()) as T;
  }
}
