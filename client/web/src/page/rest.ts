/** The REST API for the pages: typed bodies, problems as exceptions. */

import type { components } from "../contract/rest.js";
import { fillIn, texts } from "../words/words.js";

export type Schemas = components["schemas"];
export type Job = Schemas["Job"];
export type JobEvent = Schemas["Event"];
export type Progress = Schemas["Progress"];
export type Scene = Schemas["Scene"];
export type SceneReport = Schemas["SceneReportAnswer"];
export type Finding = Schemas["Finding"];
export type Preset = Schemas["Preset"];
export type Estimate = Schemas["Estimate"];
export type Bundle = Schemas["Bundle"];
export type BundleDetail = Schemas["BundleDetail"];
export type Artifact = Schemas["Artifact"];
export type Me = Schemas["Me"];
export type Share = Schemas["Share"];
export type PlannedFile = Schemas["PlannedFile"];
export type FileUpload = Schemas["FileUpload"];

/** Everything that was refused: the server's problem document (RFC 9457). */
export class Refused extends Error {
  override readonly name = "Refused";

  constructor(
    readonly status: number,
    readonly code: string,
    detail: string,
    readonly retryable: boolean,
    readonly errors: readonly Schemas["ProblemDetail"][] = [],
  ) {
    super(detail);
  }
}

/** The server did not answer at all. */
export class Unreachable extends Error {
  override readonly name = "Unreachable";
}

/** Throw the problem in a server's response, if there is one. */
export async function requireOk(response: Response): Promise<Response> {
  if (response.ok) return response;
  let problem: Partial<Schemas["ProblemDocument"]> = {};
  try {
    problem = await response.json();
  } catch {
    // Something between us and the server answered.
  }
  throw new Refused(
    response.status,
    problem.code ?? `http_${response.status}`,
    problem.detail ?? fillIn(texts.page.answered, { status: response.status }),
    problem.retryable ?? response.status >= 500,
    problem.errors ?? [],
  );
}

/** Return a key that makes one job of a request, however often it is sent. */
export function newKey(): string {
  // Not crypto.randomUUID: that one is missing where a page came over plain HTTP.
  const parts = crypto.getRandomValues(new Uint32Array(4));
  return `page-${Array.from(parts, (part) => part.toString(16)).join("")}`;
}

/** Waiting for a server. */

/** Run `work` for all items, `count` at a time. */
export async function inLines<T>(
  count: number,
  items: readonly T[],
  work: (item: T) => Promise<void>,
): Promise<void> {
  const left = [...items];
  const line = async () => {
    for (let item = left.shift(); item !== undefined; item = left.shift()) await work(item);
  };
  await Promise.all(Array.from({ length: count }, line));
}

/** Wait; ends early when the network comes back or `signal` is aborted. */
export function pause(milliseconds: number, signal: AbortSignal): Promise<void> {
  return new Promise((resolve) => {
    // Takes the listeners away when one of them was called.
    const over = new AbortController();
    const end = () => {
      clearTimeout(timer);
      over.abort();
      resolve();
    };
    const timer = setTimeout(end, milliseconds);
    signal.addEventListener("abort", end, { signal: over.signal });
    globalThis.addEventListener?.("online", end, { signal: over.signal });
  });
}

export type Api = ReturnType<typeof createApi>;

/** Return the operations of the server at this address; `send` is `fetch`, or what stands in for it. */
export function createApi(send: typeof fetch = (...given) => fetch(...given)) {
  async function request(method: string, path: string, init: RequestInit = {}): Promise<Response> {
    let response: Response;
    try {
      response = await send(path, { ...init, method, headers: { "x-lambent-csrf": "1", ...init.headers } });
    } catch (error) {
      if (init.signal?.aborted) throw error;
      throw new Unreachable(texts.page.noServerShort);
    }
    return requireOk(response);
  }

  async function answer<T>(method: string, path: string, init: RequestInit = {}): Promise<T> {
    const response = await request(method, path, init);
    return response.status === 204 ? (null as T) : ((await response.json()) as T);
  }

  const json = <T>(method: string, path: string, body?: unknown, headers = {}): Promise<T> =>
    answer<T>(
      method,
      path,
      body === undefined
        ? { headers }
        : { body: JSON.stringify(body), headers: { "content-type": "application/json", ...headers } },
    );

  const remove = (path: string, keepalive: boolean) => answer<null>("DELETE", path, { keepalive });

  const list = (path: string, limit: number, cursor: string | null) =>
    `${path}?limit=${limit}${cursor === null ? "" : `&cursor=${encodeURIComponent(cursor)}`}`;

  return {
    logIn: (code: string) => json<null>("POST", "/v1/login", { code }),
    version: () => json<Schemas["Version"]>("GET", "/v1/version"),
    me: () => json<Me>("GET", "/v1/me"),
    switchTo: (organisation: string) => json<Me>("POST", "/v1/me:switch", { organisation }),
    logOut: () => json<null>("POST", "/v1/logout"),
    scenes: (cursor: string | null = null) =>
      json<Schemas["SceneList"]>("GET", list("/v1/scenes", 50, cursor)),
    scene: (id: string) => json<Scene>("GET", `/v1/scenes/${id}`),
    report: (id: string) =>
      json<SceneReport>("GET", `/v1/scenes/${id}/report?format=json`, undefined, {
        accept: "application/json",
      }),
    createScene: (name: string) => json<Scene>("POST", "/v1/scenes", { name }),
    planFiles: (id: string, files: readonly PlannedFile[]) =>
      json<Schemas["Plan"]>("POST", `/v1/scenes/${id}/files:plan`, files),
    putFile: (id: string, sha256: string, body: Blob, signal: AbortSignal) =>
      request("PUT", `/v1/scenes/${id}/files/${sha256}`, {
        body,
        signal,
        headers: { "content-type": "application/octet-stream" },
      }),
    /** Addresses of the store for planned files. */
    offerUploads: (id: string, sha256: readonly string[]) =>
      json<Schemas["UploadList"]>("POST", `/v1/scenes/${id}/files:uploads`, { sha256 }),
    /** Let the server take over files that were sent there. */
    completeUploads: (id: string, sha256: readonly string[]) =>
      json<Schemas["TakenFiles"]>("POST", `/v1/scenes/${id}/files:complete`, { sha256 }),
    /** Send a file, or a part of one, to an address of the store, and return the status of its answer. */
    putToStore: async (
      url: string,
      headers: Readonly<Record<string, string>>,
      body: Blob,
      signal: AbortSignal,
    ) => {
      try {
        // Nothing of this site goes there: the address is all it needs.
        return (await send(url, { method: "PUT", body, headers, signal, credentials: "omit" })).status;
      } catch (error) {
        if (signal.aborted) throw error;
        throw new Unreachable(texts.page.noServerShort);
      }
    },
    putArchive: (id: string, body: Blob, mediaType: string, signal: AbortSignal) => {
      const headers = { "content-type": mediaType };
      return answer<Scene>("PUT", `/v1/scenes/${id}/archive`, { body, signal, headers });
    },
    commit: (id: string) => json<Scene>("POST", `/v1/scenes/${id}:commit`),
    /** With `keepalive` the request outlives the page. */
    deleteScene: (id: string, keepalive = false) => remove(`/v1/scenes/${id}`, keepalive),
    deleteBundle: (id: string, keepalive = false) => remove(`/v1/bundles/${id}`, keepalive),
    presets: () => json<Schemas["PresetList"]>("GET", "/v1/presets"),
    limits: () => json<Schemas["Limits"]>("GET", "/v1/limits"),
    notices: () => json<Schemas["Notices"]>("GET", "/v1/notices"),
    estimate: (preset: string) => json<Estimate>("POST", "/v1/estimates", { preset }),
    /** `given` narrows the list, as the parameters of the server do. */
    jobs: (cursor: string | null = null, given = new URLSearchParams()) =>
      json<Schemas["JobList"]>("GET", `${list("/v1/jobs", 50, cursor)}${given.size > 0 ? `&${given}` : ""}`),
    job: (id: string) => json<Job>("GET", `/v1/jobs/${id}`),
    /** Jobs of a scene, the newest first. */
    jobsOf: (sceneId: string, kind: Job["kind"], state: Job["state"], limit: number) =>
      json<Schemas["JobList"]>("GET", `/v1/jobs?scene=${sceneId}&kind=${kind}&state=${state}&limit=${limit}`),
    /** The job once it has ended, or as it is after half a minute. */
    waitForJob: (id: string, signal: AbortSignal) => answer<Job>("GET", `/v1/jobs/${id}?wait=30`, { signal }),
    deleteJob: (id: string, keepalive = false) => remove(`/v1/jobs/${id}`, keepalive),
    /** The same `key` never makes a second job. */
    submit: (order: Partial<Schemas["NewJob"]> & { scene_id: string }, key: string) =>
      json<Job>("POST", "/v1/jobs", order, { "idempotency-key": key }),
    cancel: (id: string) => json<Job>("POST", `/v1/jobs/${id}:cancel`),
    retry: (id: string) => json<Job>("POST", `/v1/jobs/${id}:retry`),
    events: (id: string, after: number) =>
      json<Schemas["EventList"]>("GET", `/v1/jobs/${id}/events?after=${after}&limit=1000`),
    log: async (id: string) => (await request("GET", `/v1/jobs/${id}/log?tail_bytes=65536`)).text(),
    artifacts: (id: string) => json<Schemas["ArtifactList"]>("GET", `/v1/jobs/${id}/artifacts`),
    bundles: (cursor: string | null = null) =>
      json<Schemas["BundleList"]>("GET", list("/v1/bundles", 50, cursor)),
    bundle: (id: string) => json<BundleDetail>("GET", `/v1/bundles/${id}`),
    /** Upload a map, .hdr or .exr. */
    createEnvironment: (name: string, body: Blob) => {
      const headers = { "content-type": "application/octet-stream" };
      const path = `/v1/environments?name=${encodeURIComponent(name)}`;
      return answer<Schemas["Environment"]>("POST", path, { body, headers });
    },
    shares: (id: string) => json<Schemas["ShareList"]>("GET", `/v1/bundles/${id}/shares`),
    createShare: (id: string, expiresInS: number, frameAncestors: readonly string[] = []) =>
      json<Share>("POST", `/v1/bundles/${id}/shares`, {
        expires_in_s: expiresInS,
        ...(frameAncestors.length > 0 ? { frame_ancestors: frameAncestors } : {}),
      }),
    revokeShare: (id: string) => json<null>("DELETE", `/v1/shares/${id}`),
    /** A JSON file among a job's artifacts. */
    document: <T>(url: string) => answer<T>("GET", url),
    /** The bytes of an artifact. */
    blob: async (url: string) => (await request("GET", url)).blob(),
    /** The answer whose body is the stream of events. */
    stream: (lastEventId: string, signal: AbortSignal) =>
      request("GET", "/v1/events", {
        signal,
        headers: lastEventId === "" ? {} : { "last-event-id": lastEventId },
      }),
  };
}
