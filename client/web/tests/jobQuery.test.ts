import { describe, expect, it } from "vitest";
import { everything, fragmentOf, matches, parametersOf, queryOf } from "../src/jobs/jobQuery.js";
import type { Job } from "../src/page/rest.js";

const job = (values: Partial<Job>): Job => ({
  ...({ id: "job_1", kind: "train", scene_name: "Copper Kettle", preset: "fast", params: {} } as Job),
  state: "running",
  ...values,
});

describe("a query of jobs", () => {
  it("comes back from its address", () => {
    const query = { words: "a & b?", state: "failed", kind: "pictures", oldestFirst: true };
    expect(queryOf(fragmentOf(query))).toEqual(query);
    expect(fragmentOf(everything)).toBe("#/");
    for (const odd of ["", "#/", "#/jobs/job_1", "#/?state=asleep&kind=constructor&sort=name"]) {
      expect(queryOf(odd)).toEqual(everything);
    }
    expect(queryOf(`#/?q=${"x".repeat(300)}`).words).toHaveLength(100);
  });

  it("asks the server only for what lists show", () => {
    expect(parametersOf(everything).getAll("kind")).toEqual(["train", "prepare", "bake", "render", "batch"]);
    const asked = parametersOf({ words: " cup ", state: "active", kind: "train", oldestFirst: true });
    expect(asked.toString()).toBe(
      "q=cup&state=queued&state=running&state=cancelling&state=retry_wait&kind=train&sort=oldest",
    );
  });

  it("takes jobs of the stream as the server would", () => {
    expect(matches(everything, job({}))).toBe(true);
    expect(matches(everything, job({ kind: "check" }))).toBe(false);
    expect(matches(everything, job({ kind: "prepare", params: { corrections: "{}" } }))).toBe(false);
    const active = { ...everything, state: "active" };
    expect(
      ["queued", "running", "new_state"].map((state) => matches(active, job({ state: state as never }))),
    ).toEqual([true, true, true]);
    expect(matches(active, job({ state: "failed" }))).toBe(false);
    expect(matches({ ...everything, state: "failed" }, job({ state: "failed" }))).toBe(true);
    expect(matches({ ...everything, kind: "pictures" }, job({ kind: "batch" }))).toBe(true);
    const said = (words: string) => matches({ ...everything, words }, job({}));
    expect(["kettle", " COPPER ", "job_", "fast"].map(said)).toEqual([true, true, true, true]);
    expect(["tea", "ob_1", "ast"].map(said)).toEqual([false, false, false]);
  });
});
