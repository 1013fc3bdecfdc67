import { describe, expect, it } from "vitest";
import { previewText, turnOf } from "../src/jobs/previews.js";

const named = (...names: string[]) => names.map((name, place) => ({ name, sha256: String(place) }));

describe("previews", () => {
  it("make a turn of the newest pictures between which the camera moved", () => {
    expect(turnOf(named("turning_cache", "turning_cache", "evaluation"))).toEqual([0, 1]);
    const long = named(...Array.from({ length: 40 }, () => "turning_joint"), "evaluation");
    expect(turnOf(long)).toEqual(Array.from({ length: 24 }, (_, place) => place + 16));
  });

  it("of which there are none, or one, do not turn", () => {
    expect(turnOf([])).toEqual([]);
    expect(turnOf(named("view", "view"))).toEqual([]);
    expect(turnOf(named("turning_cache", "evaluation"))).toEqual([]);
  });

  it("are called by what the run did", () => {
    const texts = named("turning_cache", "turning_other", "evaluation", "").map(previewText);
    expect(texts).toEqual(["training the radiance cache", "other", "evaluation", "preview"]);
  });
});
