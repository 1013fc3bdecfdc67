// The page that lists jobs. One stream tells everything that happens; the cards are changed in place, so that
// focus and selection stay where they are.

import { NotLoggedIn, follow } from "./stream.js";

/**
 * @typedef {{ stage: string, step: number, num_steps: number, fraction: number, eta_s: number, psnr: number }} Progress
 * @typedef {{ code: string, message: string }} JobError
 * @typedef {object} Job
 * @property {string} id
 * @property {string} kind
 * @property {string} scene_id
 * @property {string} preset
 * @property {string} state
 * @property {number} run
 * @property {string} created_at
 * @property {string | null} started_at
 * @property {string | null} finished_at
 * @property {Progress | null} progress
 * @property {JobError | null} error
 * @property {string | null} bundle_id
 * @typedef {object} JobEvent
 * @property {string} job_id
 * @property {string} type
 * @property {string} state
 * @property {number} run
 * @property {Progress | null} progress
 * @property {string} sha256
 * @property {string} name
 * @typedef {{ name: string, url: string }} Artifact
 * @typedef {{ job: Job, card: HTMLElement, psnr: number[], preview: string, artifacts: Artifact[] }} Entry
 */

const ENDED = new Set(["succeeded", "failed", "cancelled"]);
const STAGES = new Map([
  ["ingest", "reading the photographs"],
  ["cache", "training the radiance cache"],
  ["joint", "training materials and light"],
  ["evaluate", "evaluating"],
  ["export", "writing the bundle"],
]);
const STATES = new Map([["retry_wait", "waiting for the next try"]]);
const CURVE_POINTS = 200;

/** @type {Map<string, Entry>} */
const entries = new Map();
/** @type {Map<string, Promise<string>>} */
const sceneNames = new Map();

/**
 * @param {string} selector
 * @param {ParentNode} [parent]
 * @returns {HTMLElement}
 */
function find(selector, parent = document) {
  const element = parent.querySelector(selector);
  if (!(element instanceof Element)) throw new Error(selector);
  return /** @type {HTMLElement} */ (element);
}

/**
 * Ask the server and return the JSON it answers; a problem document becomes an Error.
 * @param {string} path
 * @param {RequestInit} [options]
 * @returns {Promise<any>}
 */
async function ask(path, options = {}) {
  const response = await fetch(path, { ...options, headers: { "x-lambent-csrf": "1", ...options.headers } });
  if (response.status === 204) return null;
  const body = await response.json();
  if (response.status === 401) throw new NotLoggedIn(body.detail);
  if (!response.ok) throw new Error(body.detail);
  return body;
}

/** @param {unknown} error */
function showError(error) {
  const text =
    error instanceof NotLoggedIn
      ? "This browser is not logged in. Open the one-time link that `lambent serve` printed."
      : String(error instanceof Error ? error.message : error);
  const place = find("#message");
  place.textContent = text;
  place.hidden = false;
}

/**
 * @param {number} seconds
 * @returns {string}
 */
export function formatDuration(seconds) {
  const whole = Math.round(seconds);
  const parts = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const [hours, minutes, rest] = parts.map((part) => String(part).padStart(2, "0"));
  return parts[0] > 0 ? `${hours}:${minutes}:${rest}` : `${minutes}:${rest}`;
}

/**
 * Return the line of figures under the bar.
 * @param {Job} job
 * @param {number | undefined} psnr the last one that was told, dB
 * @returns {string}
 */
export function describe(job, psnr) {
  const parts = [];
  const { progress } = job;
  if (job.started_at !== null && job.finished_at !== null) {
    parts.push(`took ${formatDuration((Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000)}`);
  } else if (progress !== null) {
    parts.push(STAGES.get(progress.stage) ?? progress.stage);
    if (progress.num_steps > 1) parts.push(`step ${progress.step} of ${progress.num_steps}`);
    if (progress.eta_s > 0) parts.push(`about ${formatDuration(progress.eta_s)} to go`);
  }
  if (psnr !== undefined) parts.push(`PSNR ${psnr.toFixed(1)} dB on training pixels`);
  return parts.join(" · ");
}

/**
 * Return the points of a curve that fills a box of 100 x 20.
 * @param {number[]} values
 * @returns {string}
 */
export function curve(values) {
  const low = Math.min(...values);
  const span = Math.max(...values) - low || 1;
  const at = (/** @type {number} */ place) => (100 * place) / Math.max(values.length - 1, 1);
  return values.map((value, place) => `${at(place).toFixed(2)},${(19 - (18 * (value - low)) / span).toFixed(2)}`).join(" ");
}

/**
 * @param {string} sceneId
 * @returns {Promise<string>}
 */
function sceneName(sceneId) {
  let name = sceneNames.get(sceneId);
  if (name === undefined) {
    // A scene that was removed has no name any more; its jobs stay.
    name = ask(`/v1/scenes/${sceneId}`).then((scene) => scene.name, () => sceneId);
    sceneNames.set(sceneId, name);
  }
  return name;
}

/** @param {Entry} entry */
function draw({ job, card, psnr, preview, artifacts }) {
  const ended = ENDED.has(job.state);
  card.dataset.state = job.state;
  find(".state", card).textContent = STATES.get(job.state) ?? job.state;
  const what = [job.kind === "check" ? "check of the scene" : `preset ${job.preset}`];
  if (job.run > 1) what.push(`run ${job.run}`);
  what.push(new Date(job.created_at).toLocaleString());
  find(".what", card).textContent = what.join(" · ");
  const bar = /** @type {HTMLProgressElement} */ (find("progress", card));
  bar.value = job.state === "succeeded" ? 1 : (job.progress?.fraction ?? 0);
  bar.setAttribute("aria-label", "share of the job that is done");
  find(".figures", card).textContent = describe(job, psnr.at(-1));
  const error = find(".error", card);
  error.hidden = job.error === null || job.state === "succeeded";
  error.textContent = job.error === null ? "" : `${job.error.code}: ${job.error.message}`;
  find(".cancel", card).hidden = ended;
  /** @type {HTMLButtonElement} */ (find(".cancel", card)).disabled = job.state === "cancelling";
  find(".retry", card).hidden = job.state !== "failed" && job.state !== "cancelled";
  const manifest = /** @type {HTMLAnchorElement} */ (find(".manifest", card));
  manifest.hidden = job.bundle_id === null;
  manifest.href = job.bundle_id === null ? "" : `/v1/bundles/${job.bundle_id}/manifest`;
  const image = /** @type {HTMLImageElement} */ (find(".preview", card));
  image.hidden = preview === "";
  find(".blank", card).hidden = preview !== "";
  if (preview !== "" && !image.src.endsWith(preview)) {
    image.src = `/v1/blobs/${preview}`;
    image.alt = "latest rendering of the model";
  }
  const line = find(".curve", card);
  line.toggleAttribute("hidden", psnr.length < 3);
  find("polyline", line).setAttribute("points", psnr.length < 3 ? "" : curve(psnr));
  find("title", line).textContent = `PSNR on training pixels, now ${psnr.at(-1)?.toFixed(1)} dB`;
  const links = artifacts.map(({ name, url }) => {
    const link = document.createElement("a");
    link.href = url;
    link.download = name;
    link.textContent = name;
    return link;
  });
  const place = find(".artifacts", card);
  if (place.childElementCount !== links.length) place.replaceChildren(...links);
}

/**
 * Return the entry of a job, with a new card at its place (the newest first) where there is none.
 * @param {Job} job
 * @returns {Entry}
 */
function entryOf(job) {
  const known = entries.get(job.id);
  if (known !== undefined) return known;
  const template = /** @type {HTMLTemplateElement} */ (find("#card"));
  const card = find("li", /** @type {DocumentFragment} */ (template.content.cloneNode(true)));
  const heading = find("h2", card);
  heading.id = `${job.id}_name`;
  heading.textContent = job.scene_id;
  void sceneName(job.scene_id).then((name) => (heading.textContent = name));
  for (const [button, verb] of [["cancel", "cancel"], ["retry", "retry"]]) {
    const element = find(`.${button}`, card);
    element.setAttribute("aria-describedby", heading.id);
    element.addEventListener("click", () => {
      ask(`/v1/jobs/${job.id}:${verb}`, { method: "POST" }).then(() => (find("#message").hidden = true), showError);
    });
  }
  const log = /** @type {HTMLAnchorElement} */ (find(".log", card));
  log.href = `/v1/jobs/${job.id}/log`;
  const entry = { job, card, psnr: [], preview: "", artifacts: [] };
  entries.set(job.id, entry);
  const later = [...entries.keys()].filter((id) => id < job.id).sort().at(-1);
  find("#jobs").insertBefore(card, later === undefined ? null : /** @type {Entry} */ (entries.get(later)).card);
  find("#empty").hidden = true;
  return entry;
}

/**
 * Show a job as it is, with what its history says about pictures and PSNR.
 * @param {Job} job
 */
async function showJob(job) {
  const entry = entryOf(job);
  entry.job = job;
  draw(entry);
  const [history, made] = await Promise.all([
    ask(`/v1/jobs/${job.id}/events`),
    ENDED.has(job.state) ? ask(`/v1/jobs/${job.id}/artifacts`) : { items: [] },
  ]);
  entry.psnr = [];
  for (const event of history.items) addEvent(entry, event);
  entry.artifacts = made.items;
  draw(entry);
}

/**
 * Take the part of an event that the curve and the picture show.
 * @param {Entry} entry
 * @param {JobEvent} event
 */
function addEvent(entry, event) {
  if (event.type === "preview") entry.preview = event.sha256;
  if (event.progress !== null && event.progress.psnr > 0) {
    entry.psnr = [...entry.psnr, event.progress.psnr].slice(-CURVE_POINTS);
  }
}

/**
 * @param {import("./stream.js").StreamMessage} message
 */
function receive(message) {
  const data = JSON.parse(message.data);
  if (message.event === "snapshot") {
    showJob(data).catch(showError);
    return;
  }
  /** @type {JobEvent} */
  const event = data;
  const entry = entries.get(event.job_id);
  if (entry === undefined || event.type === "state") {
    ask(`/v1/jobs/${event.job_id}`).then(showJob).catch(showError);
    return;
  }
  addEvent(entry, event);
  if (event.progress !== null) entry.job = { ...entry.job, progress: event.progress };
  draw(entry);
}

/** @param {boolean} connected */
function showConnection(connected) {
  find("#connection").textContent = connected ? "live" : "the server does not answer; trying again …";
}

/** Swap the code of a one-time link for a session, and take it out of the address. */
async function logIn() {
  const code = new URLSearchParams(location.hash.slice(1)).get("code");
  if (code === null) return;
  history.replaceState(null, "", location.pathname);
  const headers = { "content-type": "application/json" };
  await ask("/v1/login", { method: "POST", body: JSON.stringify({ code }), headers });
}

/** Load the jobs before those that are shown, page by page. */
async function offerOlder() {
  const button = /** @type {HTMLButtonElement} */ (find("#older"));
  /** @type {string | null} */
  let cursor = (await ask("/v1/jobs?limit=100")).next_cursor;
  find("#empty").hidden = entries.size > 0 || cursor !== null;
  button.hidden = cursor === null;
  button.addEventListener("click", async () => {
    button.disabled = true;
    try {
      const page = await ask(`/v1/jobs?limit=50&cursor=${cursor}`);
      cursor = page.next_cursor;
      await Promise.all(page.items.map(showJob));
      button.hidden = cursor === null;
    } catch (error) {
      showError(error);
    } finally {
      button.disabled = false;
    }
  });
}

async function main() {
  try {
    await logIn();
  } catch {
    // The link was used before; this browser may have been the one that used it.
  }
  try {
    void offerOlder().catch(showError);
    await follow(receive, showConnection);
  } catch (error) {
    find("#connection").textContent = "";
    showError(error);
  }
}

void main();
