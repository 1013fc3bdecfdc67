import { describe, expect, it } from "vitest";
import { estimateText, parseSettings } from "../src/jobs/orderForm.js";
import { measured, ordered } from "../src/jobs/report.js";
import { metricRows, verdicts } from "../src/jobs/verdicts.js";
import { explain } from "../src/page/actions.js";
import { bundleAt, jobAddress, placeOf, sceneAddress, viewerAddress } from "../src/page/addresses.js";
import { formatAbout, formatDuration, formatSize } from "../src/page/format.js";
import {
  createApi,
  type Estimate,
  type Finding,
  Refused,
  requireOk,
  type SceneReport,
  Unreachable,
} from "../src/page/rest.js";

describe("addresses", () => {
  it("lead back to what they were made of", () => {
    expect(placeOf(jobAddress("job_1"))).toEqual({ kind: "job", id: "job_1" });
    expect(placeOf(sceneAddress("scene_1"))).toEqual({ kind: "scene", id: "scene_1" });
    for (const odd of ["", "#/", "#/jobs/", "#/jobs/../x", "#/bundles/x", "#code=abc"]) {
      expect(placeOf(odd)).toEqual({ kind: "start" });
    }
    expect(viewerAddress("bundle_1")).toBe("viewer.html#src=%2Fv1%2Fbundles%2Fbundle_1");
    const page = "http://here:8020/viewer.html";
    expect(bundleAt("/v1/bundles/bundle_1", page)).toBe("bundle_1");
    expect(bundleAt("http://here:8020/v1/bundles/bundle_1/", page)).toBe("bundle_1");
    for (const other of ["data/bundle/", "http://there/v1/bundles/bundle_1", "/v1/bundles/a/files/"]) {
      expect(bundleAt(other, page)).toBeNull();
    }
  });
});

describe("numbers", () => {
  it("are written for people", () => {
    const said = (format: (value: number) => string, ...values: number[]) => values.map(format).join(", ");
    expect(said(formatDuration, 0, 61, 3725, -3)).toBe("0:00, 1:01, 1:02:05, 0:00");
    expect(said(formatAbout, 2, 44, 360, 9000)).toBe("5 seconds, 45 seconds, 6 minutes, 2.5 hours");
    expect(said(formatSize, 12, 1536, 5 * 2 ** 20, 2 ** 31)).toBe("12 B, 1.5 KiB, 5.0 MiB, 2.0 GiB");
  });

  it("of an estimate say where they come from", () => {
    const estimate = { preset: "fast", seconds: 360, num_measured: 0, num_ahead: 0 } as Estimate;
    expect(estimateText(estimate)).toBe("about 6 minutes on the hardware it is made for");
    expect(estimateText({ ...estimate, num_measured: 3 })).toBe("about 6 minutes, measured here on 3 jobs");
    expect(estimateText({ ...estimate, seconds: null })).toBe("no estimate yet");
  });

  it("of an evaluation carry unit and standard error", () => {
    const metrics = [
      { name: "nvs/psnr", value: 31.234, unit: "dB", standard_error: 0.5 },
      { name: "nvs/ssim", value: 0.98765, unit: "1", standard_error: 0 },
    ];
    expect(metricRows({ metrics })).toEqual([
      ["nvs/psnr", "31.23 dB", "± 0.50"],
      ["nvs/ssim", "0.9877", ""],
    ]);
    expect(metricRows({})).toEqual([]);
  });

  it("of an evaluation are put in words that follow from the error, the worst last", () => {
    const said = (value: number, name = "nvs/psnr", unit = "dB") =>
      verdicts({ metrics: [{ name, value, unit }] }).map((each) => Object.values(each).join(": "));
    expect(said(40)).toEqual(["New views: 40.0 dB: hard to tell from the photographs"]);
    for (const value of [29.9, 27.31, 26]) expect(said(value)[0]).toContain("very close to the photographs");
    expect(said(22)[0]).toContain(": close;");
    expect(said(18)[0]).toContain("recognisable");
    expect(said(12)[0]).toContain("far from the photographs");
    expect(said(20, "training_views/psnr")[0]).toContain("Training views");
    expect(said(35, "relight/psnr")[0]).toContain("hard to tell from the real pictures");
    const shape = "Shape: 6.2° off: correct overall, with small dents";
    expect(said(6.21, "normal/mae_mask", "deg")).toEqual([shape]);
    expect(said(0.3, "roughness/rmse", "1")[0]).toContain("gloss is not reliable");
    expect([...said(0.9, "nvs/ssim", "1"), ...said(Number.NaN), ...verdicts({})]).toEqual([]);
  });
});

describe("settings", () => {
  it("are lines of name and value", () => {
    expect(parseSettings(" stage_two.num_rays = 512 \n\nlights=a,b=c")).toEqual({
      "stage_two.num_rays": "512",
      lights: "a,b=c",
    });
    for (const wrong of ["num_rays", "=1", "A=1", "a..b=1"])
      expect(() => parseSettings(wrong)).toThrow(wrong);
  });
});

describe("a report", () => {
  const frames = { num_train_frames: 40, num_test_frames: 6 };
  const report = { layout: "colmap", layout_title: "COLMAP", ...frames, figures: null } as SceneReport;

  it("has errors first", () => {
    const finding = (code: string, severity: string) => ({ code, severity }) as Finding;
    const found = ordered([finding("a", "warning"), finding("b", "error"), finding("c", "warning")]);
    expect(found.map((each) => each.code)).toEqual(["b", "a", "c"]);
  });

  it("says what was measured, and nothing where nothing was", () => {
    expect(measured(report)).toEqual([
      ["Layout", "COLMAP"],
      ["Views", "40 for training, 6 for testing"],
    ]);
    expect(measured({ ...report, layout: "", num_train_frames: 0, num_test_frames: 0 })).toEqual([]);
  });
});

describe("the interface", () => {
  const answer = (status: number, body: unknown) => new Response(JSON.stringify(body), { status });

  it("turns a problem document into an exception with its code and pointers", async () => {
    const errors = [{ pointer: "#/x", message: "y" }];
    const problem = { code: "quota_jobs", detail: "too many", retryable: true, errors };
    const refused = await requireOk(answer(429, problem)).catch((error) => error);
    expect(refused).toBeInstanceOf(Refused);
    expect(refused).toMatchObject({ status: 429, code: "quota_jobs", retryable: true });
    expect(explain(refused)).toBe("too many\nx: y");
    const proxy = await requireOk(new Response("<html>", { status: 502 })).catch((error) => error);
    expect(proxy).toMatchObject({ code: "http_502", retryable: true });
  });

  it("sends the header that other sites cannot, and tells when nobody answers", async () => {
    const seen: [string, RequestInit | undefined][] = [];
    const api = createApi(async (path, init) => {
      seen.push([String(path), init]);
      return answer(202, { id: "job_1" });
    });
    await api.submit({ scene_id: "scene_1" }, "key-1");
    expect(seen[0]![0]).toBe("/v1/jobs");
    expect(seen[0]![1]!.headers).toMatchObject({ "x-lambent-csrf": "1", "idempotency-key": "key-1" });
    const away = createApi(() => Promise.reject(new TypeError("network")));
    await expect(away.jobs()).rejects.toThrow(Unreachable);
  });
});
