import { afterEach, describe, expect, it, vi } from "vitest";
import { refusal } from "../src/bundle/answers.js";
import { openSource, secretOf } from "../src/bundle/source.js";
import { linkWithView } from "../src/page/addresses.js";
import { workerScript } from "../src/page/workers.js";
import { sharedView } from "../src/share/link.js";
import { elementSnippet, frameSnippet, originsIn } from "../src/share/snippets.js";

const secret = `share_01abc.${"0f".repeat(32)}`;
const bundle = "https://lambent.example/v1/bundles/bundle_1";

afterEach(() => vi.unstubAllGlobals());

describe("the page of a share link", () => {
  const at = { pathname: "/embed/share_01abc", origin: "https://lambent.example" };

  it("shows the bundle with the secret and the view of its fragment", () => {
    const view = "env=preset%3Asky&controls=1&src=https%3A%2F%2Fevil.example";
    const shown = sharedView({ ...at, hash: `#${linkWithView(secret, view)}` }, "bundle_1");
    expect(shown).toEqual({
      source: `${bundle}#${secret}`,
      poster: "https://lambent.example/embed/share_01abc/picture",
      state: "env=preset%3Asky",
      controls: true,
    });
  });

  it("leaves controls to where it is shown", () => {
    const shown = (hash: string) => sharedView({ ...at, hash }, "bundle_1");
    expect(shown(`#${secret}`)).toMatchObject({ controls: null, state: "" });
    expect(shown(`#${secret}&controls=0`)).toMatchObject({ controls: false });
  });

  it.each([
    ["", "bundle_1", "incomplete"],
    [`#${secret}`, "", "expired"],
  ])("says what is missing: %j, %j", (hash, bundleId, text) => {
    expect(sharedView({ ...at, hash }, bundleId)).toEqual({ message: expect.stringContaining(text) });
  });
});

describe("the secret behind an address", () => {
  it("is one of our bundles' only", () => {
    expect(secretOf(`${bundle}#${secret}`)).toBe(secret);
    expect(secretOf(`${bundle}/#${secret}`)).toBe(secret);
    expect(secretOf(bundle)).toBeNull();
    expect(secretOf(`${bundle}#share_1.abc`)).toBeNull();
    expect(secretOf(`${bundle}#x${secret}`)).toBeNull();
    expect(secretOf(`https://lambent.example/bowl.relight/#${secret}`)).toBeNull();
  });

  it("is sent in a header, with nothing of the visitor, and not in the address", async () => {
    const asked: [string, RequestInit][] = [];
    vi.stubGlobal("fetch", async (url: URL, init: RequestInit) => {
      asked.push([url.href, init]);
      return new Response("{}");
    });
    await (await openSource({ kind: "url", url: `${bundle}#${secret}` })).read("manifest.json", 100);
    await (await openSource({ kind: "url", url: bundle })).read("manifest.json", 100);
    const address = `${bundle}/files/manifest.json`;
    expect(asked).toEqual([
      [address, { headers: { authorization: `Bearer ${secret}` }, credentials: "omit" }],
      [address, { headers: {}, credentials: "same-origin" }],
    ]);
  });

  it("that is refused is a link that ended", () => {
    const address = new URL(bundle);
    expect(refusal(401, "manifest.json", address, true).code).toBe("bundle.link_ended");
    expect(refusal(401, "manifest.json", address).code).toBe("bundle.login_needed");
  });
});

describe("the script of a worker", () => {
  it("is the module itself on its own site, and a script that imports it elsewhere", async () => {
    const module = new URL("https://lambent.example/assets/bundleWorker-1a2b.js");
    expect(workerScript(module, "https://lambent.example")).toBe(module.href);
    const blobs: Blob[] = [];
    vi.stubGlobal("URL", Object.assign(URL, { createObjectURL: (blob: Blob) => `blob:${blobs.push(blob)}` }));
    expect(workerScript(module, "https://shop.example")).toBe("blob:1");
    expect(workerScript(module, "https://shop.example")).toBe("blob:1");
    expect(await blobs[0]!.text()).toBe(`import "${module.href}";`);
  });
});

describe("the HTML for another page", () => {
  const share = {
    id: "share_01abc",
    bundle_id: "bundle_1",
    url: `https://lambent.example/embed/share_01abc#${secret}`,
    created_at: "",
    expires_at: "",
    frame_ancestors: ["https://shop.example"],
  };

  it("is a frame with the link and the view, escaped", () => {
    expect(frameSnippet(share, "rotate=3,0,0&env=preset:sky")).toContain(
      `src="${share.url}&amp;rotate=3,0,0&amp;env=preset:sky"`,
    );
    expect(frameSnippet(share, '"><script>')).not.toContain('"><script>');
  });

  it("is the element with the bundle, the secret and the poster", () => {
    const text = elementSnippet(share, "rotate=3,0,0&ev=1");
    expect(text).toContain(`<lambent-viewer src="${bundle}#${secret}" state="rotate=3,0,0&amp;ev=1"`);
    expect(text).toContain('poster="https://lambent.example/embed/share_01abc/picture"');
    expect(text).toContain('src="https://lambent.example/lambent-viewer.js"');
    expect(secretOf(/lambent-viewer src="([^"]+)"/.exec(text)![1]!)).toBe(secret);
  });

  it("is for the origins of the addresses that someone types", () => {
    expect(originsIn(" https://Shop.example/bowls?x=1, shop.example:8443\nhttps://shop.example ")).toEqual([
      "https://shop.example",
      "https://shop.example:8443",
    ]);
    expect(originsIn("")).toEqual([]);
    // The server says what is wrong with it.
    expect(originsIn("https://*.exa mple")).toEqual(["https://*.exa", "https://mple"]);
    expect(originsIn("mailto:a@b.example")).toHaveLength(1);
  });
});
