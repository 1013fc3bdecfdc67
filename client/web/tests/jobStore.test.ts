import { beforeEach, describe, expect, it } from "vitest";
import { chart, thinned } from "../src/jobs/curves.js";
import { progressText } from "../src/jobs/jobLine.js";
import { stageSeconds, stageStates } from "../src/jobs/live.js";
import { type JobRecord, JobStore, type Sample } from "../src/jobs/store.js";
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
  const made = { id: "job_a", kind: "train", state: "running", run: 1, progress: null, last_event: 0 };
  return { ...made, finished_at: null, bundle_id: null, thumbnail_url: null, ...values } as Job;
}

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
    const seq = this.history.length + 1;
    const at = new Date(Date.UTC(2026, 0, 1, 0, 0, seq)).toISOString();
    const rest = { run: 1, state: "" as const, message: "", sha256: "", name: "" };
    const one = { job_id: "job_a", seq, at, type: "progress" as const, progress, ...rest, ...values };
    this.history.push(one);
    return one;
  }
}

const preview = (name: string, sha256: string) =>
  ({ type: "preview", sha256, name, progress: null }) as const;

describe("JobStore", () => {
  let server: FakeServer;
  let store: JobStore;
  beforeEach(() => {
    server = new FakeServer();
    store = new JobStore(server);
  });

  /** Let the store read the history of so many events. */
  const loaded = (count: number) => {
    for (let place = 0; place < count; place++) server.add();
    return store.loadHistory("job_a");
  };

  /** Send the store some messages; return the record once it has done what they ask for. */
  async function received(...all: JobEvent[]): Promise<JobRecord> {
    for (const one of all) store.receive({ event: "event", id: "", data: JSON.stringify(one) });
    await new Promise((resolve) => setTimeout(resolve, 0));
    return store.get("job_a")!;
  }

  it("fetches a long history in pages and then follows the stream without asking", async () => {
    await loaded(2500);
    expect(server.asked).toEqual([0, 1000, 2000]);
    const record = await received(server.add({ progress: { ...progress, psnr: 20, step: 9 } }));
    expect(record.psnr).toHaveLength(2501);
    expect(record.psnr.at(-1)!.value).toBe(20);
    expect(record.job.progress?.step).toBe(9);
    expect(server.asked).toHaveLength(3);
  });

  it("takes an event once, however often it comes", async () => {
    await loaded(1);
    const next = server.add(preview("view", "ab"));
    const record = await received(next, next, server.history[0]!);
    expect(record.previews).toEqual([{ sha256: "ab", name: "view" }]);
    expect(record.job.thumbnail_url).toBe("/v1/blobs/ab");
    expect(record.psnr).toHaveLength(1);
  });

  it("keeps the picture of the object when the sheet of the evaluation comes", async () => {
    await loaded(1);
    const all = [server.add(preview("turning_joint", "ab")), server.add(preview("evaluation", "cd"))];
    const record = await received(...all);
    expect(record.previews.map((each) => each.sha256)).toEqual(["ab", "cd"]);
    expect(record.job.thumbnail_url).toBe("/v1/blobs/ab");
  });

  it("fetches what the stream has left out", async () => {
    await loaded(1);
    server.add();
    server.add();
    const { psnr } = await received(server.add());
    expect(psnr.map((sample) => sample.atS % 60)).toEqual([1, 2, 3, 4]);
  });

  it("fetches what happened before a snapshot of a job whose history is shown", async () => {
    await loaded(1);
    server.add();
    store.receive({ event: "snapshot", id: "", data: JSON.stringify(job({ last_event: 2 })) });
    expect((await received()).seq).toBe(2);
  });

  it("asks for the whole job when its state changes, and tells who listens", async () => {
    const told: string[] = [];
    store.listen((id) => told.push(id));
    store.put(job());
    server.current = job({ state: "succeeded", bundle_id: "bundle_a" });
    const record = await received(server.add({ type: "state", state: "succeeded", progress: null }));
    expect(record.job.bundle_id).toBe("bundle_a");
    expect(told).toContain("job_a");
  });

  it("does not go back to an older state of a job", () => {
    store.put(job({ last_event: 5, state: "succeeded" }));
    store.put(job({ last_event: 4, state: "running" }));
    expect(store.get("job_a")!.job.state).toBe("succeeded");
  });

  it("sorts jobs by age, the newest first", () => {
    for (const id of ["job_b", "job_c", "job_a"]) store.put(job({ id }));
    expect(store.all().map((record) => record.job.id)).toEqual(["job_c", "job_b", "job_a"]);
  });
});

describe("stages", () => {
  it("are done, now or to come", () => {
    const now = stageStates(job({ progress: { ...progress, stage: "joint" } }));
    expect(now.map(([, state]) => state).join(" ")).toBe("done done done done now waiting waiting waiting");
    expect(stageStates(job({ state: "succeeded" })).every(([, state]) => state === "done")).toBe(true);
    expect(stageStates(job()).every(([, state]) => state === "waiting")).toBe(true);
  });

  it.each([
    ["joint", "training materials and light · step 1 of 10"],
    ["contact_sheet", "laying out the contact sheet · step 1 of 10"],
  ])("have names, also those of jobs that train nothing: %s", (stage, text) => {
    expect(progressText(job({ progress: { ...progress, stage, psnr: 0, eta_s: 0 } }))).toBe(text);
  });

  it("take the time until the next one begins", () => {
    const began = Date.UTC(2026, 0, 1) / 1000;
    const record = {
      job: job({ finished_at: "2026-01-01T00:01:00.000Z" }),
      seq: 3,
      psnr: [],
      loss: [],
      previews: [],
      stages: new Map([
        ["ingest", began],
        ["cache", began + 10],
      ]),
    };
    const seconds = ["ingest", "cache", "export"].map((stage) => stageSeconds(record, stage));
    expect(seconds).toEqual([10, 50, null]);
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
