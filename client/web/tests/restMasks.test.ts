import { beforeEach, describe, expect, it, vi } from "vitest";
import { isListed, purpose } from "../src/jobs/jobLine.js";
import { verdict } from "../src/jobs/masksView.js";
import { documentOf } from "../src/masks/corrections.js";
import {
  correctionsOf,
  latestPrepared,
  type Preparation,
  type PreparationApi,
  RestMaskBackend,
  readPrepared,
} from "../src/masks/restBackend.js";
import { masksAddress, placeOf } from "../src/page/addresses.js";
import type { Artifact, Job } from "../src/page/rest.js";

const marked = (frame: string) => documentOf([{ frame, label: "object", box: [0, 0, 9, 9] }]);
const [marks, others] = [marked("a"), marked("b")];

function job(values: Partial<Job> = {}): Job {
  return {
    id: "job_0",
    kind: "prepare",
    scene_id: "scene_a",
    preset: "tiny",
    params: {},
    seed: 3,
    state: "succeeded",
    error: null,
    ...values,
  } as Job;
}

/** A server that prepares at once: the mask of a frame that is marked is another. */
class FakeServer implements PreparationApi {
  readonly jobs = new Map<string, Job>([
    ["job_0", job({ params: { layout: "colmap", "stage_one.num_steps": "7" } })],
  ]);
  readonly keys: string[] = [];
  readonly deleted: string[] = [];
  readonly cancelled: string[] = [];
  state: Job["state"] = "succeeded";

  submit = async (order: Parameters<PreparationApi["submit"]>[0], key: string) => {
    this.keys.push(key);
    const made = job({ ...order, id: `job_${this.jobs.size}`, state: "queued" } as unknown as Job);
    this.jobs.set(made.id, made);
    return made;
  };
  waitForJob = async (id: string) => {
    const error =
      this.state === "failed" ? { code: "c", message: "cannot be used", cause: "", run: 1 } : null;
    const done = { ...this.jobs.get(id)!, state: this.state, error };
    this.jobs.set(id, done);
    return done;
  };
  artifacts = async (id: string) => {
    const marked = correctionsOf(this.jobs.get(id)!).corrections.map(({ frame }) => frame);
    const file = (name: string, sha256: string): Artifact => ({
      name,
      sha256,
      url: sha256,
      size_bytes: 1,
      media_type: "x",
    });
    const frames = ["a", "b"].flatMap((name) => [
      file(`preparation/pictures/${name}.jpg`, `picture of ${name}`),
      file(
        `preparation/masks/${name}.png`,
        marked.includes(name) ? `mask of ${name} in ${id}` : `mask of ${name}`,
      ),
    ]);
    return { items: [file("preparation/frames.json", id), ...frames], next_cursor: null };
  };
  document = async <T>() => preparation as T;
  blob = async (url: string) => new Blob([url]);
  cancel = async (id: string) => {
    this.cancelled.push(id);
    return this.jobs.get(id)!;
  };
  deleteJob = async (id: string) => {
    this.deleted.push(id);
    return null;
  };
  jobsOf = async () => ({ items: [...this.jobs.values()].reverse(), next_cursor: null });
}

const frame = (name: string) => ({
  name,
  width: 4000,
  height: 3000,
  picture: `pictures/${name}.jpg`,
  mask: `masks/${name}.png`,
});
const preparation: Preparation = {
  version: 1,
  editable: true,
  overlap: 0.91,
  doubtful: ["b"],
  reason: "",
  frames: [frame("a"), frame("b")],
};

async function opened(server: FakeServer) {
  let keys = 0;
  const prepared = await readPrepared(server, (await latestPrepared(server, "scene_a"))!);
  return new RestMaskBackend(server, "scene_a", prepared, () => `key ${keys++}`);
}
const { signal } = new AbortController();

describe("masks on a server", () => {
  let server: FakeServer;
  let backend: RestMaskBackend;
  beforeEach(async () => {
    server = new FakeServer();
    backend = await opened(server);
  });

  it("are shown as the newest job has left them, in pixels of the photographs", async () => {
    server.jobs.set("job_1", job({ id: "job_1", params: { corrections: JSON.stringify(marks) } }));
    backend = await opened(server);
    const capture = await backend.load();
    expect(capture.corrections).toEqual(marks);
    expect(capture.agreement).toBe(0.91);
    expect(capture.frames).toEqual([
      { name: "a", width: 4000, height: 3000, doubtful: false },
      { name: "b", width: 4000, height: 3000, doubtful: true },
    ]);
    expect(await (await backend.mask("a")).text()).toBe("mask of a in job_1");
    expect(await (await backend.picture("b", 1600)).text()).toBe("picture of b");
  });

  it("are corrected by jobs that read the capture in the same way, of which the last one stays", async () => {
    expect((await backend.apply(marks, signal)).changed).toEqual(["a"]);
    expect(server.jobs.get("job_1")!.params).toEqual({
      layout: "colmap",
      corrections: JSON.stringify(marks),
    });
    expect(server.jobs.get("job_1")!.seed).toBe(3);
    expect((await backend.apply(others, signal)).changed).toEqual(["a", "b"]);
    // The jobs of before stay.
    expect(server.deleted).toEqual(["job_1"]);
    expect(new Set(server.keys).size).toBe(2);
  });

  it("are kept at the end, and computed once more only where they differ", async () => {
    await backend.apply(marks, signal);
    expect(await backend.finish(marks)).toBe("#/scenes/scene_a");
    expect(server.jobs.size).toBe(2);
    await backend.finish(documentOf([]));
    expect(server.jobs.get("job_2")!.params).toEqual({ layout: "colmap" });
  });

  it("stay as they were where corrections fail, with the reason", async () => {
    server.state = "failed";
    await expect(backend.apply(marks, signal)).rejects.toThrow("cannot be used");
    expect(await (await backend.mask("a")).text()).toBe("mask of a");
  });

  it("take no answer to corrections that were overtaken, and end their job", async () => {
    const overtaken = new AbortController();
    vi.spyOn(server, "waitForJob").mockImplementationOnce(async () => {
      overtaken.abort();
      throw overtaken.signal.reason;
    });
    await expect(backend.apply(marks, overtaken.signal)).rejects.toThrow();
    expect(server.cancelled).toEqual(["job_1"]);
    expect(await (await backend.mask("a")).text()).toBe("mask of a");
  });

  it("of another version are not shown", async () => {
    vi.spyOn(server, "document").mockResolvedValue({ ...preparation, version: 2 });
    await expect(opened(server)).rejects.toThrow("version 2");
  });

  it("have a verdict in words", async () => {
    const prepared = await readPrepared(server, job());
    const told = (values: Partial<Preparation>) =>
      verdict({ ...prepared, preparation: { ...preparation, ...values } });
    expect(told({})).toBe("Agreement between the views: 91%; least certain: b.");
    expect(told({ reason: "too few views" })).toContain("too few views");
    expect(told({ editable: false })).toContain("came with");
  });

  it("have a place of their own, and their jobs are not listed one by one", () => {
    expect(placeOf(masksAddress("scene_1"))).toEqual({ kind: "masks", id: "scene_1" });
    expect(placeOf("#/jobs/job_1/masks")).toEqual({ kind: "start" });
    expect(purpose(job())).toBe("cameras and masks");
    expect(isListed(job())).toBe(true);
    expect(isListed(job({ params: { corrections: "{}" } }))).toBe(false);
  });
});
