import { describe, expect, it } from "vitest";
import { chart, thinned } from "../src/jobs/curves.js";
import { progressText } from "../src/jobs/jobLine.js";
import { byStage, stageSeconds, stageStates } from "../src/jobs/live.js";
import { JobStore, type Sample } from "../src/jobs/store.js";
import type { Job, JobEvent, Progress } from "../src/page/rest.js";

const progress: Progress = {
  stage: "cache",
  step: 1,
  num_steps: 10,
  fraction: 0.1,
  eta_s: 9,
  steps_per_s: 1,
  loss: 0.5,
  psnr: 12,
  doing: "",
};

function job(values: Partial<Job> = {}): Job {
  return {
    id: "job_a",
    kind: "train",
    scene_id: "scene_a",
    scene_name: "a scene",
    preset: "tiny",
    params: {},
    gpus: 0,
    priority: 0,
    labels: {},
    seed: 0,
    state: "running",
    run: 1,
    created_at: "2026-01-01T00:00:00.000Z",
    started_at: "2026-01-01T00:00:01.000Z",
    finished_at: null,
    retry_at: null,
    progress: null,
    error: null,
    bundle_id: null,
    batch_id: null,
    thumbnail_url: null,
    last_event: 0,
    webhook: null,
    ...values,
  };
}

function event(seq: number, values: Partial<JobEvent> = {}): JobEvent {
  const at = new Date(Date.UTC(2026, 0, 1, 0, 0, seq)).toISOString();
  const rest = { run: 1, state: "" as const, message: "", sha256: "", name: "" };
  return { job_id: "job_a", seq, at, type: "progress", progress, ...rest, ...values };
}

const message = (one: JobEvent) => ({ event: "event", id: "", data: JSON.stringify(one) });
const settle = () => new Promise((resolve) => setTimeout(resolve, 0));

/** A server with one job and its history. */
class FakeServer {
  current = job();
  history: JobEvent[] = [];
  asked: number[] = [];
  readonly job = async () => ({ ...this.current, last_event: this.history.length });
  readonly events = async (_: string, after: number) => {
    this.asked.push(after);
    const items = this.history.filter((one) => one.seq > after).slice(0, 1000);
    return { items, next_cursor: null };
  };
  add(values: Partial<JobEvent> = {}): JobEvent {
    const one = event(this.history.length + 1, values);
    this.history.push(one);
    return one;
  }
}

describe("JobStore", () => {
  it("fetches a long history in pages and then follows the stream without asking", async () => {
    const server = new FakeServer();
    for (let place = 0; place < 2500; place++) server.add();
    const store = new JobStore(server);
    await store.loadHistory("job_a");
    expect(server.asked).toEqual([0, 1000, 2000]);
    store.receive(message(server.add({ progress: { ...progress, psnr: 20, step: 9 } })));
    await settle();
    const record = store.get("job_a")!;
    expect(record.psnr).toHaveLength(2501);
    expect(record.psnr.at(-1)!.value).toBe(20);
    expect(record.job.progress?.step).toBe(9);
    expect(server.asked).toHaveLength(3);
  });

  it("takes an event once, however often it comes", async () => {
    const server = new FakeServer();
    server.add();
    const store = new JobStore(server);
    await store.loadHistory("job_a");
    const next = server.add({ type: "preview", sha256: "ab", name: "view", progress: null });
    store.receive(message(next));
    store.receive(message(next));
    store.receive(message(server.history[0]!));
    await settle();
    expect(store.get("job_a")!.previews).toEqual([{ sha256: "ab", name: "view" }]);
    expect(store.get("job_a")!.job.thumbnail_url).toBe("/v1/blobs/ab");
    expect(store.get("job_a")!.psnr).toHaveLength(1);
  });

  it("keeps the picture of the object when the sheet of the evaluation comes", async () => {
    const server = new FakeServer();
    server.add();
    const store = new JobStore(server);
    await store.loadHistory("job_a");
    store.receive(
      message(server.add({ type: "preview", sha256: "ab", name: "turning_joint", progress: null })),
    );
    store.receive(message(server.add({ type: "preview", sha256: "cd", name: "evaluation", progress: null })));
    await settle();
    expect(store.get("job_a")!.previews.map((each) => each.sha256)).toEqual(["ab", "cd"]);
    expect(store.get("job_a")!.job.thumbnail_url).toBe("/v1/blobs/ab");
  });

  it("fetches what the stream has left out", async () => {
    const server = new FakeServer();
    server.add();
    const store = new JobStore(server);
    await store.loadHistory("job_a");
    server.add();
    server.add();
    store.receive(message(server.add()));
    await settle();
    expect(store.get("job_a")!.psnr.map((sample) => sample.atS % 60)).toEqual([1, 2, 3, 4]);
  });

  it("fetches what happened before a snapshot of a job whose history is shown", async () => {
    const server = new FakeServer();
    server.add();
    const store = new JobStore(server);
    await store.loadHistory("job_a");
    server.add();
    const snapshot = { event: "snapshot", id: "", data: JSON.stringify(job({ last_event: 2 })) };
    store.receive(snapshot);
    await settle();
    expect(store.get("job_a")!.seq).toBe(2);
  });

  it("asks for the whole job when its state changes, and tells who listens", async () => {
    const server = new FakeServer();
    const store = new JobStore(server);
    const told: string[] = [];
    store.listen((id) => told.push(id));
    store.put(job());
    server.current = job({ state: "succeeded", bundle_id: "bundle_a" });
    store.receive(message(server.add({ type: "state", state: "succeeded", progress: null })));
    await settle();
    expect(store.get("job_a")!.job.bundle_id).toBe("bundle_a");
    expect(told).toContain("job_a");
  });

  it("does not go back to an older state of a job", () => {
    const store = new JobStore(new FakeServer());
    store.put(job({ last_event: 5, state: "succeeded" }));
    store.put(job({ last_event: 4, state: "running" }));
    expect(store.get("job_a")!.job.state).toBe("succeeded");
  });

  it("sorts jobs by age, the newest first", () => {
    const store = new JobStore(new FakeServer());
    for (const id of ["job_b", "job_c", "job_a"]) store.put(job({ id }));
    expect(store.all().map((record) => record.job.id)).toEqual(["job_c", "job_b", "job_a"]);
  });
});

describe("stages", () => {
  it("are done, now or to come", () => {
    const now = stageStates(job({ progress: { ...progress, stage: "joint" } }));
    expect(now.map(([, state]) => state)).toEqual([
      "done",
      "done",
      "done",
      "done",
      "now",
      "waiting",
      "waiting",
      "waiting",
    ]);
    expect(stageStates(job({ state: "succeeded" })).every(([, state]) => state === "done")).toBe(true);
    expect(stageStates(job()).every(([, state]) => state === "waiting")).toBe(true);
  });

  it("are told in words, also those of jobs that train nothing", () => {
    const told = (stage: string): string =>
      progressText(job({ state: "running", progress: { ...progress, stage, psnr: 0, doing: "", eta_s: 0 } }));
    expect(told("joint")).toBe("training materials and light · step 1 of 10");
    expect(told("contact_sheet")).toBe("laying out the contact sheet · step 1 of 10");
  });

  it("take the time until the next one begins", () => {
    const record = {
      job: job({ finished_at: "2026-01-01T00:01:00.000Z" }),
      seq: 3,
      psnr: [],
      loss: [],
      previews: [],
      stages: new Map([
        ["ingest", Date.UTC(2026, 0, 1) / 1000],
        ["cache", Date.UTC(2026, 0, 1, 0, 0, 10) / 1000],
      ]),
    };
    expect(stageSeconds(record, "ingest")).toBe(10);
    expect(stageSeconds(record, "cache")).toBe(50);
    expect(stageSeconds(record, "export")).toBeNull();
  });
});

describe("samples", () => {
  it("make a curve for each stage, in the order in which they began", () => {
    const sample = (stage: string, value: number): Sample => ({ atS: value, stage, value });
    const found = byStage([sample("joint", 1), sample("joint", 2), sample("cache", 3)]);
    expect([...found].map(([stage, samples]) => [stage, samples.map(({ value }) => value)])).toEqual([
      ["joint", [1, 2]],
      ["cache", [3]],
    ]);
  });
});

describe("a curve", () => {
  const sample = (atS: number, value: number): Sample => ({ atS, value, stage: "cache" });

  it("goes up with its values, from left to right", () => {
    const drawn = chart([sample(100, 10), sample(110, 20), sample(140, 30)], 400, 100);
    const points = "0.00,98.00 100.00,50.00 400.00,2.00";
    expect(drawn).toEqual({ points, lowest: 10, highest: 30, spanS: 40 });
  });

  it("shows factors as equal distances where it is logarithmic", () => {
    const drawn = chart([sample(0, 1), sample(1, 0.1), sample(2, 0.01)], 2, 100, true)!;
    expect(drawn.points).toBe("0.00,2.00 1.00,50.00 2.00,98.00");
  });

  it("is nothing for a single sample, and a line for a constant", () => {
    expect(chart([sample(0, 1)], 10, 10)).toBeNull();
    expect(chart([sample(0, 1), sample(1, 1)], 10, 10)!.points).not.toContain("NaN");
  });

  it("is thinned, its ends kept", () => {
    const many = Array.from({ length: 1000 }, (_, place) => sample(place, place));
    const few = thinned(many, 50);
    expect([few.length, few[0]!.value, few[49]!.value]).toEqual([50, 0, 999]);
    expect(thinned(few, 50)).toEqual(few);
  });
});
