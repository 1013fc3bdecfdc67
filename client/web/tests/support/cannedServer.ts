/** What a server answers to pages whose pictures are taken: always the same scenes, jobs and bundles. */

import type { Page, Route } from "playwright-core";
import type { Artifact, Job, JobEvent, Progress, Scene, SceneReport, Schemas } from "../../src/page/rest.js";
import { mask, photograph } from "./drawings.js";

/** The contents of the server: nothing, everything, or nothing that this browser may see. */
export type World = "empty" | "full" | "locked";

const day = "2026-03-05T";

function scene(id: string, name: string, state: Scene["state"], thumbnail: string | null): Scene {
  return {
    ...{ id, name, state, layout: state === "open" ? null : "photographs" },
    created_at: `${day}09:12:00Z`,
    committed_at: state === "open" ? null : `${day}09:14:00Z`,
    content_sha256: null,
    num_files: state === "open" ? 0 : 64,
    size_bytes: state === "open" ? 0 : 187_400_000,
    thumbnail_url: thumbnail === null ? null : `/v1/blobs/${thumbnail}`,
    labels: {},
  };
}

const scenes: readonly Scene[] = [
  scene("scene_5", "Blue vase", "ready", "photo_62"),
  scene("scene_4", "Copper kettle on a rather long table in the kitchen", "ready", "photo_05"),
  scene("scene_3", "Garden gnome", "rejected", null),
  scene("scene_2", "Green bowl", "uploaded", "photo_33"),
  scene("scene_1", "Walking boots", "open", null),
];

const finding = (severity: "error" | "warning", code: string, subject: string, message: string) => ({
  ...{ severity, code, subject, message },
});
const findings: Readonly<Record<string, SceneReport["findings"]>> = {
  scene_5: [
    finding("warning", "capture.gap", "", "no photograph looks from the back (120° to 205°); add some"),
    finding("warning", "capture.blurred", "IMG_0012.jpg", "is blurred; the sharpest others are used"),
  ],
  scene_3: [
    finding("error", "capture.too_few", "", "there are 3 photographs; at least 20 from all sides are needed"),
    finding("error", "capture.unreadable", "IMG_0002.jpg", "cannot be decoded; export it again as JPEG"),
    finding("warning", "capture.exposure", "IMG_0003.jpg", "is two stops brighter than the others"),
  ],
};

function report({ id, state }: Scene): SceneReport {
  const checked = state === "ready" || state === "rejected";
  return {
    ...{ checked, scene_id: id, state, usable: state === "ready" },
    findings: findings[id] ?? [],
    layout: checked ? "photographs" : "",
    layout_title: checked ? "photographs, whose cameras are found first" : "",
    num_train_frames: checked ? 56 : 0,
    num_test_frames: checked ? 8 : 0,
    figures: !checked
      ? null
      : {
          ...{ exposure_range_ev: 0.42, gap_deg: 85, upper_gap_deg: 42, has_hull: true, has_masks: false },
          ...{ lowest_elevation_deg: 4, highest_elevation_deg: 61, lacks_cameras: false, views: [] },
          ...{ num_train_views: 56, outside_box_share: 0, schema_version: "1.0" },
          ...{ upper_gap_azimuth_deg: 160, upper_gap_elevation_deg: 25 },
        },
  };
}

function progress(stage: string, step: number, psnr: number): Progress {
  return {
    ...{ stage, step, psnr, doing: "", num_steps: 1500, fraction: step / 3000, steps_per_s: 12.5 },
    ...{ loss: 0.2 / (1 + step / 100), eta_s: 240 },
  };
}

function job(id: string, scene_id: string, state: Job["state"], more: Partial<Job> = {}): Job {
  const began = state !== "queued";
  const ended = ["succeeded", "failed", "cancelled"].includes(state);
  return {
    ...{
      id,
      scene_id,
      state,
      kind: "train",
      preset: "fast",
      priority: 0,
      seed: 0,
      gpus: 0,
      run: began ? 1 : 0,
    },
    scene_name: scenes.find((each) => each.id === scene_id)?.name ?? "",
    ...{ batch_id: null, bundle_id: null, labels: {}, params: {}, error: null, retry_at: null },
    created_at: `${day}10:00:00Z`,
    started_at: began ? `${day}10:00:05Z` : null,
    finished_at: ended ? `${day}10:04:11Z` : null,
    ...{ progress: null, last_event: 0, thumbnail_url: null, webhook: null, ...more },
  };
}

const jobs: readonly Job[] = [
  job("job_6", "scene_4", "queued"),
  job("job_5", "scene_5", "running", {
    ...{ progress: progress("joint", 640, 24.6), last_event: 30, thumbnail_url: "/v1/blobs/photo_62" },
  }),
  job("job_4", "scene_2", "failed", {
    ...{ preset: "long", last_event: 14 },
    error: {
      ...{ code: "scene.masks_empty", cause: "", run: 1 },
      message: "the object was found in 3 of 56 photographs; mark it in one of the others",
    },
  }),
  job("job_3", "scene_5", "succeeded", {
    ...{ bundle_id: "bundle_1", last_event: 44, thumbnail_url: "/v1/blobs/photo_62" },
  }),
  job("job_2", "scene_4", "cancelled", { preset: "quick" }),
  job("job_1", "scene_5", "succeeded", {
    ...{ kind: "prepare", bundle_id: null, thumbnail_url: "/v1/blobs/photo_62" },
  }),
];

/** Return the history of a job: what a run tells while it gets better. */
function events({ id, last_event: count }: Job): JobEvent[] {
  return Array.from({ length: count }, (_, index) => {
    const isPreview = index % 5 === 4;
    const [stage, place] = index < 14 ? ["cache", index] : ["joint", index - 14];
    const step = 40 * place;
    const at = new Date(Date.parse(`${day}10:00:10Z`) + 8000 * index).toISOString();
    const psnr = (stage === "cache" ? 26 : 23) - 12 * Math.exp(-place / 4);
    return {
      ...{ at, job_id: id, message: "", run: 1, seq: index + 1, state: "" as const },
      type: isPreview ? "preview" : "progress",
      name: isPreview ? `turning_${stage}` : "",
      sha256: isPreview ? `photo_62_${index}` : "",
      progress: isPreview ? null : progress(stage, step, psnr),
    };
  });
}

const bundle: Schemas["BundleDetail"] = {
  ...{ id: "bundle_1", job_id: "job_3", scene_id: "scene_5", scene_name: "Blue vase", num_files: 13 },
  ...{ created_at: `${day}10:04:10Z`, size_bytes: 24_600_000, thumbnail_url: "/v1/blobs/photo_62" },
  labels: {},
  files: [
    ["mesh/asset.glb", 6_400_000],
    ["mesh/asset.usdz", 7_100_000],
    ["models/weights.bin", 9_200_000],
  ].map(([path, size]) => ({
    ...{ path: String(path), size_bytes: Number(size), media_type: "application/octet-stream" },
    ...{ sha256: String(path), url: `/v1/blobs/${path}` },
  })),
};

const metric = (name: string, value: number, unit: string, standard_error: number) => ({
  ...{ name, value, unit, standard_error },
});
const evaluation = {
  num_views: 8,
  metrics: [
    metric("nvs/psnr", 31.42, "dB", 0.21),
    metric("relight/psnr", 24.87, "dB", 0.34),
    metric("normal/mae_mask", 7.31, "deg", 0.12),
    metric("roughness/rmse", 0.1182, "1", 0.004),
    metric("albedo_rgb_ratio/psnr_gamma", 27.63, "dB", 0.18),
  ],
};

const frames = Array.from({ length: 12 }, (_, index) => `IMG_${String(index + 1).padStart(4, "0")}`);
const preparation = {
  ...{ version: 1, editable: true, overlap: 0.93, doubtful: ["IMG_0007"], reason: "" },
  frames: frames.map((name) => ({
    ...{ name, width: 3000, height: 2250, picture: `pictures/${name}.png`, mask: `masks/${name}.png` },
  })),
};

function artifact(name: string, url: string, size_bytes = 1200): Artifact {
  return { name, url, size_bytes, sha256: name, media_type: "application/octet-stream" };
}

const artifacts: Readonly<Record<string, readonly Artifact[]>> = {
  job_1: [
    artifact("preparation/frames.json", "/v1/blobs/preparation"),
    ...frames.flatMap((name, index) => [
      artifact(`preparation/pictures/${name}.png`, `/v1/blobs/photo_62_${3 * index}`),
      artifact(`preparation/masks/${name}.png`, "/v1/blobs/mask"),
    ]),
  ],
  job_3: [
    artifact("report.json", "/v1/blobs/report"),
    artifact("report.html", "/v1/blobs/report.html", 48_000),
    artifact("contact_sheet.png", "/v1/blobs/contact", 320_000),
  ],
};

const presets: Schemas["PresetList"] = {
  default: "fast",
  items: [
    ["quick", "A first look in about a minute and a half on two CPU cores.", 0],
    ["fast", "A first result in about four minutes on two CPU cores.", 0],
    ["long", "The best result without a GPU, in about 40 minutes.", 0],
    ["standard", "Daily use on one GPU with 24 GB.", 1],
  ].map(([name, description, gpus]) => ({
    ...{ name: String(name), description: String(description), gpus: Number(gpus) },
  })),
};
const seconds: Readonly<Record<string, number>> = { quick: 90, fast: 240, long: 2400, standard: 1200 };

const share: Schemas["Share"] = {
  ...{
    id: "share_1",
    bundle_id: "bundle_1",
    created_at: `${day}11:00:00Z`,
    expires_at: "2026-03-12T11:00:00Z",
  },
  url: "https://lambent.example/embed/share_1#c2VjcmV0LW9mLXRoZS1saW5r",
  frame_ancestors: ["https://shop.example"],
};

const log = Array.from({ length: 12 }, (_, index) => `10:00:${10 + index} joint step=${100 * index}`).join(
  "\n",
);

type Request = { readonly id: string; readonly given: URLSearchParams; readonly isEmpty: boolean };

const page = (items: readonly unknown[], isEmpty = false) => ({
  items: isEmpty ? [] : items,
  next_cursor: null,
});
const find = <T extends { readonly id: string }>(list: readonly T[], id: string) =>
  list.find((each) => each.id === id);

function jobsOf(given: URLSearchParams): readonly Job[] {
  const [words, scene, kind, state] = ["q", "scene", "kind", "state"].map((name) => given.get(name));
  return jobs.filter(
    (each) =>
      each.scene_name.toLowerCase().includes((words ?? "").toLowerCase()) &&
      (scene == null || each.scene_id === scene) &&
      (kind == null || each.kind === kind) &&
      (state == null || each.state === state),
  );
}

/** What is answered as JSON. */
const answers: Readonly<Record<string, (request: Request) => unknown>> = {
  "GET jobs": ({ given, isEmpty }) => page(jobsOf(given), isEmpty),
  "GET scenes": ({ isEmpty }) => page(scenes, isEmpty),
  "GET bundles": ({ isEmpty }) => page([bundle], isEmpty),
  "GET jobs/ID": ({ id }) => find(jobs, id),
  "GET jobs/ID/events": ({ id, given }) =>
    page(events(find(jobs, id)!).filter(({ seq }) => seq > Number(given.get("after")))),
  "GET jobs/ID/artifacts": ({ id }) => page(artifacts[id] ?? []),
  "GET scenes/ID": ({ id }) => find(scenes, id),
  "GET scenes/ID/report": ({ id }) => report(find(scenes, id)!),
  "GET presets": () => presets,
  "GET notices": () => ({ drain: null, maintenance: null }),
  "GET limits": () => ({ max_gpus: 0 }),
  "GET bundles/ID": () => bundle,
  "GET bundles/ID/shares": () => page([share]),
  "GET blobs/ID": ({ id }) => ({ report: evaluation, preparation })[id],
  "POST scenes": () => scene("scene_6", "Blue vase", "open", null),
};

/** Return the answer to a request as JSON, or undefined if there is none. */
function answer(method: string, { pathname, searchParams: given }: URL, isEmpty: boolean): unknown {
  const [, , kind, id, part] = pathname.split("/");
  const wanted = [kind, id === undefined ? [] : ["ID"], part ?? []].flat().join("/");
  return answers[`${method} ${wanted}`]?.({ id: id ?? "", given, isEmpty });
}

/** A browser that has opened a one-time link. */
const visitor: Schemas["Me"] = {
  ...{ kind: "session", user_id: null, name: "", organisation: "default", organisation_name: "default" },
  ...{ scopes: ["admin", "read", "render", "submit"], organisations: [] },
};

async function serve(route: Route, world: World): Promise<void> {
  const request = route.request();
  const url = new URL(request.url());
  const version = { name: "lambent", version: "1.0", api: "v1", sign_in_url: null };
  if (url.pathname === "/v1/version") return route.fulfill({ json: version });
  if (url.pathname === "/v1/me" && world !== "locked") return route.fulfill({ json: visitor });
  if (world === "locked") {
    return route.fulfill({ status: 401, json: { code: "unauthenticated", detail: "log in" } });
  }
  const picture = /^\/v1\/blobs\/(photo|mask)_?(\d+)?_?(\d+)?$/.exec(url.pathname);
  if (picture !== null) {
    const [, kind, hue, turn] = picture;
    const side = -0.8 + 0.05 * Number(turn ?? 4);
    const body = kind === "mask" ? mask() : photograph(Number(hue) / 100, side);
    return route.fulfill({ body, contentType: "image/png" });
  }
  // The bundle itself is a fixture that the server of the tests has.
  if (/^\/v1\/bundles\/\w+\/files\//.test(url.pathname)) return route.fallback();
  if (url.pathname === "/v1/estimates") {
    const { preset } = request.postDataJSON() as { preset: string };
    const estimate = {
      longest_s: null,
      shortest_s: null,
      num_ahead: 1,
      num_measured: preset === "fast" ? 4 : 0,
    };
    return route.fulfill({ json: { ...estimate, preset, seconds: seconds[preset] } });
  }
  if (url.pathname.endsWith("/files:plan")) {
    const planned = request.postDataJSON() as { sha256: string }[];
    return route.fulfill({
      json: { missing: planned.map(({ sha256 }) => sha256), unsupported: [], uploads: [] },
    });
  }
  // An upload that is under way stays so.
  if (request.method() === "PUT") return;
  if (url.pathname.endsWith("/log")) return route.fulfill({ body: log, contentType: "text/plain" });
  const json = answer(request.method(), url, world === "empty");
  if (json !== undefined) return route.fulfill({ json });
  const detail = `nothing is known of ${request.method()} ${url.pathname}`;
  return route.fulfill({ status: 404, json: { code: "not_found", detail } });
}

/** Answer a page's requests to the server, whose stream of events is open and silent. */
export async function answerAs(page: Page, world: World): Promise<void> {
  await page.unroute("**/v1/**");
  await page.route("**/v1/**", (route) => serve(route, world));
  if (world === "locked") return;
  await page.addInitScript(() => {
    const ask = globalThis.fetch;
    globalThis.fetch = async (address, init) =>
      address === "/v1/events" ? new Response(new ReadableStream()) : ask(address, init);
  });
}
