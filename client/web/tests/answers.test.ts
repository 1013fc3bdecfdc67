import { afterEach, describe, expect, it, vi } from "vitest";
import { refusal, silence } from "../src/bundle/answers.js";
import { BundleFault } from "../src/page/fault.js";
import { openSource } from "../src/bundle/source.js";

const ours = new URL("http://studio:8080/v1/bundles/b1/files/manifest.json");
const other = new URL("https://cdn.example/chair/manifest.json");

afterEach(() => vi.unstubAllGlobals());

describe("an answer that is not a bundle", () => {
  it.each([
    [401, "bundle.login_needed", "one-time link"],
    [403, "bundle.forbidden", "share link"],
    [404, "bundle.manifest_missing", "list of bundles"],
    [410, "bundle.gone", "deleted"],
    [429, "bundle.server_busy", "in a minute"],
    [500, "bundle.server_failed", "log"],
    [503, "bundle.server_failed", "in a minute"],
  ])("%i is %s, and says what to do", (status, code, advice) => {
    const fault = refusal(status, "manifest.json", ours);
    expect(fault.code).toBe(code);
    expect(fault.message).toContain(advice);
    expect(fault.message).toMatch(/studio:8080|deleted/);
  });

  it("of another host asks for the folder, and a missing file for a new export", () => {
    expect(refusal(404, "manifest.json", other).message).toContain("the folder that holds manifest.json");
    expect(refusal(404, "mesh/asset.glb", other).code).toBe("bundle.file_missing");
  });

  it("that does not come is the device's or the host's fault", () => {
    expect(silence(other, false).code).toBe("bundle.offline");
    expect(silence(other, true).code).toBe("bundle.missing");
    expect(silence(other, true).message).toContain("https://cdn.example");
  });

  it("reaches whoever opens a folder or an archive", async () => {
    const code = (url: string) =>
      openSource({ kind: "url", url })
        .then((source) => source.read("manifest.json", 1000))
        .then(
          () => "read",
          (error: unknown) => (error instanceof BundleFault ? error.code : String(error)),
        );
    vi.stubGlobal("fetch", async () => new Response("", { status: 401 }));
    expect(await code("http://studio/v1/bundles/b1")).toBe("bundle.login_needed");
    expect(await code("http://studio/chair.relight.zip")).toBe("bundle.login_needed");
    vi.stubGlobal("fetch", async () => Promise.reject(new TypeError("Failed to fetch")));
    expect(await code("http://studio/v1/bundles/b1")).toBe("bundle.missing");
    vi.stubGlobal("navigator", { onLine: false });
    expect(await code("http://studio/v1/bundles/b1")).toBe("bundle.offline");
  });
});
