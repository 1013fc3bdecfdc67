import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { follow, parse, type StreamMessage } from "../src/jobs/stream.js";
import { Refused, Unreachable } from "../src/page/rest.js";

const block = (id: string, data = "{}", event = "event") => `event: ${event}\nid: ${id}\ndata: ${data}\n\n`;

describe("parse", () => {
  it("returns whole messages and keeps the rest", () => {
    const text = `: hello\n\n${block("a:1", '{"x":": "}')}event: snapshot\nid: a`;
    const { messages, rest } = parse(text);
    expect(messages).toEqual([{ event: "event", id: "a:1", data: '{"x":": "}' }]);
    expect(rest).toBe("event: snapshot\nid: a");
  });
});

/** A server whose streams a test writes by hand; `faults` come before the next stream. */
class FakeServer {
  readonly asked: string[] = [];
  faults: Error[] = [];
  current: ReadableStreamDefaultController<Uint8Array> | null = null;
  cancelled = 0;

  readonly stream = async (last: string, signal: AbortSignal): Promise<Response> => {
    this.asked.push(last);
    const fault = this.faults.shift();
    if (fault !== undefined) throw fault;
    const body = new ReadableStream<Uint8Array>({
      start: (controller) => {
        this.current = controller;
      },
      cancel: () => {
        this.cancelled += 1;
      },
    });
    signal.throwIfAborted();
    return new Response(body);
  };

  /** Send a text and let it arrive. */
  async write(text: string): Promise<void> {
    this.current!.enqueue(new TextEncoder().encode(text));
    await vi.advanceTimersByTimeAsync(0);
  }

  /** Break the stream, and wait for what follows. */
  async breakOff(waitMs = 600): Promise<void> {
    this.current!.close();
    await vi.advanceTimersByTimeAsync(waitMs);
  }
}

describe("follow", () => {
  let server: FakeServer;
  let heard: StreamMessage[];
  let states: boolean[];
  let end: AbortController;
  let following: Promise<void>;

  beforeEach(() => {
    vi.useFakeTimers();
    [server, heard, states, end] = [new FakeServer(), [], [], new AbortController()];
  });
  afterEach(async () => {
    end.abort();
    await vi.advanceTimersByTimeAsync(20_000);
    await following.catch(() => {});
    vi.useRealTimers();
  });

  const start = () => {
    following = follow({
      api: server,
      onMessage: (message) => heard.push(message),
      onConnection: (connected) => states.push(connected),
      signal: end.signal,
    });
    following.catch(() => {});
    return vi.advanceTimersByTimeAsync(0);
  };

  it("continues after the last message when the stream breaks", async () => {
    await start();
    const text = block("a:1") + block("a:1,b:4");
    await server.write(text.slice(0, 9));
    await server.write(text.slice(9));
    await server.breakOff();
    expect(server.asked).toEqual(["", "a:1,b:4"]);
    expect(heard.map((message) => message.id)).toEqual(["a:1", "a:1,b:4"]);
    expect(states).toEqual([true, false, true]);
  });

  it("keeps its place through messages without one and refusals for the time being", async () => {
    await start();
    await server.write(`${block("a:1")}event: snapshot\ndata: {}\n\n`);
    expect(heard).toHaveLength(2);
    server.faults = [new Refused(429, "quota_streams", "full", true)];
    await server.breakOff(1_700);
    expect(server.asked).toEqual(["", "a:1", "a:1"]);
  });

  it("waits longer each time for a server that does not answer, up to a limit", async () => {
    server.faults = Array.from({ length: 40 }, () => new Unreachable("away"));
    await start();
    await vi.advanceTimersByTimeAsync(60_000);
    // 0.5 + 1 + 2 + 4 + 8 s, then every 10 s.
    expect(server.asked.length).toBeGreaterThanOrEqual(9);
    expect(server.asked.length).toBeLessThanOrEqual(12);
  });

  it("opens a connection anew that has been quiet for too long", async () => {
    await start();
    for (let minute = 0; minute < 4; minute++) {
      await vi.advanceTimersByTimeAsync(15_000);
      await server.write(": ping\n\n");
    }
    expect(server.asked).toHaveLength(1);
    await vi.advanceTimersByTimeAsync(50_000);
    expect(server.cancelled).toBe(1);
    expect(server.asked).toHaveLength(2);
  });

  it("opens the connection anew at once when the machine has slept", async () => {
    await start();
    await server.write(block("a:7"));
    await vi.advanceTimersByTimeAsync(5_000);
    // The clock continues while timers stand still.
    vi.setSystemTime(Date.now() + 3_600_000);
    await vi.advanceTimersByTimeAsync(5_100);
    expect(server.asked).toEqual(["", "a:7"]);
  });

  it("begins with snapshots where the server cannot use the positions", async () => {
    await start();
    await server.write(block("a:7"));
    server.faults = [new Refused(422, "last_event_id", "no", false)];
    await server.breakOff(3_000);
    expect(server.asked).toEqual(["", "a:7", ""]);
  });

  it("does not send positions that are longer than a server reads", async () => {
    await start();
    await server.write(block(`${"a".repeat(8000)}:1`));
    await server.breakOff();
    expect(server.asked).toEqual(["", ""]);
  });

  it("gives up where the browser is not logged in", async () => {
    server.faults = [new Refused(401, "not_authenticated", "no", false)];
    await start();
    await expect(following).rejects.toThrow(Refused);
  });
});
