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

/** Return whether a job has ended; a job of an unknown state has not. */
export function isFinal({ state }: Pick<Job, "state">): boolean {
  return ["succeeded", "failed", "cancelled"].includes(state);
}

/** A request that the server refused, with its problem document (RFC 9457). */
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
    // A proxy answered instead of the server.
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

/** Sends requests to the server of this page by `send`, and throws what it refuses. */
class Sender {
  constructor(private readonly send: typeof fetch) {}

  /** Send a request, and return its answer, whatever its status. */
  async attempt(path: string, init: RequestInit): Promise<Response> {
    try {
      return await this.send(path, init);
    } catch (error) {
      if (init.signal?.aborted) throw error;
      throw new Unreachable(texts.page.noServerShort);
    }
  }

  async request(method: string, path: string, init: RequestInit = {}): Promise<Response> {
    const headers = { "x-lambent-csrf": "1", ...init.headers };
    return requireOk(await this.attempt(path, { ...init, method, headers }));
  }

  async answer<T>(method: string, path: string, init: RequestInit = {}): Promise<T> {
    const response = await this.request(method, path, init);
    return response.status === 204 ? (null as T) : ((await response.json()) as T);
  }

  get<T>(path: string, headers = {}): Promise<T> {
    return this.answer<T>("GET", path, { headers });
  }

  /** Return a page of a list. */
  list<T>(path: string, cursor: string | null, given = new URLSearchParams()): Promise<T> {
    const parameters = new URLSearchParams([["limit", "50"], ...given]);
    if (cursor !== null) parameters.set("cursor", cursor);
    return this.get<T>(`${path}?${parameters}`);
  }

  post<T>(path: string, body?: unknown, headers = {}): Promise<T> {
    if (body === undefined) return this.answer<T>("POST", path, { headers });
    const typed = { "content-type": "application/json", ...headers };
    return this.answer<T>("POST", path, { body: JSON.stringify(body), headers: typed });
  }

  /** Delete something; with `keepalive` the request outlives the page. */
  remove(path: string, keepalive = false): Promise<null> {
    return this.answer<null>("DELETE", path, { keepalive });
  }
}

const binary = { "content-type": "application/octet-stream" };

/** Return the operations of the server of this page; `send` is `fetch`, or its replacement in tests. */
export function createApi(send: typeof fetch = (...given) => fetch(...given)) {
  const sender = new Sender(send);
  return { ...visitorApi(sender), ...sceneApi(sender), ...jobApi(sender), ...bundleApi(sender) };
}

function visitorApi(sender: Sender) {
  return {
    logIn: (code: string) => sender.post<null>("/v1/login", { code }),
    logOut: () => sender.post<null>("/v1/logout"),
    version: () => sender.get<Schemas["Version"]>("/v1/version"),
    me: () => sender.get<Me>("/v1/me"),
    switchTo: (organisation: string) => sender.post<Me>("/v1/me:switch", { organisation }),
    limits: () => sender.get<Schemas["Limits"]>("/v1/limits"),
    notices: () => sender.get<Schemas["Notices"]>("/v1/notices"),
  };
}

function sceneApi(sender: Sender) {
  return {
    scenes: (cursor: string | null = null) => sender.list<Schemas["SceneList"]>("/v1/scenes", cursor),
    scene: (id: string) => sender.get<Scene>(`/v1/scenes/${id}`),
    report: (id: string) =>
      sender.get<SceneReport>(`/v1/scenes/${id}/report?format=json`, { accept: "application/json" }),
    createScene: (name: string) => sender.post<Scene>("/v1/scenes", { name }),
    planFiles: (id: string, files: readonly PlannedFile[]) =>
      sender.post<Schemas["Plan"]>(`/v1/scenes/${id}/files:plan`, files),
    putFile: (id: string, sha256: string, body: Blob, signal: AbortSignal) =>
      sender.request("PUT", `/v1/scenes/${id}/files/${sha256}`, { body, signal, headers: binary }),
    /** Addresses of the store for planned files. */
    offerUploads: (id: string, sha256: readonly string[]) =>
      sender.post<Schemas["UploadList"]>(`/v1/scenes/${id}/files:uploads`, { sha256 }),
    /** Let the server take over files that were sent there. */
    completeUploads: (id: string, sha256: readonly string[]) =>
      sender.post<Schemas["TakenFiles"]>(`/v1/scenes/${id}/files:complete`, { sha256 }),
    /** Send a file, or a part of one, to an address of the store, and return the status of its answer. */
    putToStore: async (
      url: string,
      headers: Readonly<Record<string, string>>,
      body: Blob,
      signal: AbortSignal,
    ) =>
      // Nothing of this site goes there: the address is all it needs.
      (await sender.attempt(url, { method: "PUT", body, headers, signal, credentials: "omit" })).status,
    putArchive: (id: string, body: Blob, mediaType: string, signal: AbortSignal) => {
      const headers = { "content-type": mediaType };
      return sender.answer<Scene>("PUT", `/v1/scenes/${id}/archive`, { body, signal, headers });
    },
    commit: (id: string) => sender.post<Scene>(`/v1/scenes/${id}:commit`),
    deleteScene: (id: string, keepalive = false) => sender.remove(`/v1/scenes/${id}`, keepalive),
    /** Upload a map, .hdr or .exr. */
    createEnvironment: (name: string, body: Blob) => {
      const path = `/v1/environments?name=${encodeURIComponent(name)}`;
      return sender.answer<Schemas["Environment"]>("POST", path, { body, headers: binary });
    },
  };
}

function jobApi(sender: Sender) {
  return {
    presets: () => sender.get<Schemas["PresetList"]>("/v1/presets"),
    estimate: (preset: string) => sender.post<Estimate>("/v1/estimates", { preset }),
    /** `given` narrows the list, as the parameters of the server do. */
    jobs: (cursor: string | null = null, given = new URLSearchParams()) =>
      sender.list<Schemas["JobList"]>("/v1/jobs", cursor, given),
    job: (id: string) => sender.get<Job>(`/v1/jobs/${id}`),
    /** Jobs of a scene, the newest first. */
    jobsOf: (sceneId: string, kind: Job["kind"], state: Job["state"], limit: number) =>
      sender.get<Schemas["JobList"]>(`/v1/jobs?scene=${sceneId}&kind=${kind}&state=${state}&limit=${limit}`),
    /** The job once it has ended, or as it is after half a minute. */
    waitForJob: (id: string, signal: AbortSignal) =>
      sender.answer<Job>("GET", `/v1/jobs/${id}?wait=30`, { signal }),
    deleteJob: (id: string, keepalive = false) => sender.remove(`/v1/jobs/${id}`, keepalive),
    /** The same `key` never makes a second job. */
    submit: (order: Partial<Schemas["NewJob"]> & { scene_id: string }, key: string) =>
      sender.post<Job>("/v1/jobs", order, { "idempotency-key": key }),
    cancel: (id: string) => sender.post<Job>(`/v1/jobs/${id}:cancel`),
    retry: (id: string) => sender.post<Job>(`/v1/jobs/${id}:retry`),
    events: (id: string, after: number) =>
      sender.get<Schemas["EventList"]>(`/v1/jobs/${id}/events?after=${after}&limit=1000`),
    log: async (id: string) => (await sender.request("GET", `/v1/jobs/${id}/log?tail_bytes=65536`)).text(),
    artifacts: (id: string) => sender.get<Schemas["ArtifactList"]>(`/v1/jobs/${id}/artifacts`),
    /** A JSON file among a job's artifacts. */
    document: <T>(url: string) => sender.get<T>(url),
    /** The bytes of an artifact. */
    blob: async (url: string) => (await sender.request("GET", url)).blob(),
    /** The answer whose body is the stream of events. */
    stream: (lastEventId: string, signal: AbortSignal) =>
      sender.request("GET", "/v1/events", {
        signal,
        headers: lastEventId === "" ? {} : { "last-event-id": lastEventId },
      }),
  };
}

function bundleApi(sender: Sender) {
  return {
    bundles: (cursor: string | null = null) => sender.list<Schemas["BundleList"]>("/v1/bundles", cursor),
    bundle: (id: string) => sender.get<BundleDetail>(`/v1/bundles/${id}`),
    deleteBundle: (id: string, keepalive = false) => sender.remove(`/v1/bundles/${id}`, keepalive),
    shares: (id: string) => sender.get<Schemas["ShareList"]>(`/v1/bundles/${id}/shares`),
    createShare: (id: string, expiresInS: number, frameAncestors: readonly string[] = []) =>
      sender.post<Share>(`/v1/bundles/${id}/shares`, {
        expires_in_s: expiresInS,
        ...(frameAncestors.length > 0 ? { frame_ancestors: frameAncestors } : {}),
      }),
    revokeShare: (id: string) => sender.remove(`/v1/shares/${id}`),
  };
}
