/** Refines pictures in a worker. */

import { BundleFault } from "../bundle/fault.js";
import { openBundle } from "../bundle/manifest.js";
import { openSource } from "../bundle/source.js";
import { buffersOf } from "../page/buffers.js";
import type { PreparedLight } from "../light/prepare.js";
import { adaptedNote } from "./adapted.js";
import { Accumulation } from "./accumulation.js";
import { Hits, HitScene } from "./hitRadiance.js";
import { LightSampler } from "./lightSampler.js";
import type { OpenQuestion, RefineAnswer, RefineQuestion, StartQuestion } from "./messages.js";
import { onePass } from "./passes.js";
import { brightness, SkyLight } from "./skyLight.js";
import { surfacePoints } from "./surfacePoints.js";
import { type CacheFiles, openTracer, RefineFault, type Tracer } from "./tracer.js";

/** Directions of a point in one pass. */
const perPass = 4;
/** Passes before their differences say anything about the noise. */
const leastPasses = 4;
/** Pictures that are shown before are sent at most so often, ms. */
const sendEveryMs = 250;
const seed = 1;

type Opened = { readonly tracer: Tracer; readonly scene: HitScene; readonly originOffset: number };
type Light = { readonly levels: PreparedLight["levels"]; readonly sampler: LightSampler };

let opened: Opened | null = null;
let light: Light | null = null;
let current = 0;
let work: Promise<void> = Promise.resolve();

function answer(message: RefineAnswer, transfer: Transferable[] = []): void {
  self.postMessage(message, { transfer });
}

self.onmessage = ({ data }: MessageEvent<RefineQuestion>) => {
  current = data.ask === "start" ? data.id : 0;
  if (data.ask === "stop") return;
  const before = work;
  work = before.then(async () => {
    try {
      if (data.ask === "open") await open(data);
      else await refine(data);
    } catch (error) {
      const known = error instanceof BundleFault || error instanceof RefineFault;
      const code = error instanceof BundleFault ? error.code : known ? "refine.unavailable" : "refine.failed";
      answer({ kind: "failed", code, message: error instanceof Error ? error.message : String(error) });
    }
  });
};

async function open({ origin, sceneId, mesh, transport, backend }: OpenQuestion): Promise<void> {
  const files = await cacheFiles(origin, sceneId);
  const { tracer, note } = await openTracer(files, backend);
  const scene = new HitScene(transport, mesh);
  opened = { tracer, scene, originOffset: files.manifest.secondaryRays?.originOffset ?? 0 };
  const notes = [note, adaptedNote(files.manifest)].filter((text) => text !== "").join("; ");
  answer({ kind: "opened", backend: tracer.backend, note: notes, slow: tracer.slow });
}

/** Fetch and check a fast cache; any of them will do, since no light changes what rays hit. */
async function cacheFiles(origin: OpenQuestion["origin"], sceneId: string): Promise<CacheFiles> {
  const { manifest, read } = await openBundle(await openSource(origin));
  if (manifest.sceneId !== sceneId) {
    throw new BundleFault("bundle.digest_mismatch", "the bundle is another one by now", "reload the page");
  }
  const graph = manifest.graphs.find(({ name }) => name === "fast_cache");
  if (graph === undefined) {
    throw new BundleFault(
      "bundle.graph_missing",
      "this bundle carries baked light transport and no networks",
      "use a bundle of the full tier",
    );
  }
  const [model, weights] = await Promise.all([read(graph.path), read("models/weights.bin")]);
  return { manifest, model, weights };
}

async function refine(question: StartQuestion): Promise<void> {
  const { id, options, seen } = question;
  const stopped = (): boolean => current !== id;
  if (opened === null || stopped()) return;
  const { levels } = question;
  if (levels !== null) light = { levels, sampler: new LightSampler(brightness(levels)) };
  if (light === null) throw new Error("a picture without light was asked for");
  const { tracer, scene, originOffset } = opened;
  const sky = new SkyLight(light.levels, question.turn, question.intensity);
  const points = surfacePoints(seen, question.edit);
  const hits = question.indirect ? new Hits(scene, sky, question.falling, question.edit) : null;
  const sums = new Accumulation(points, seen.camera, seen.samples);
  let sentAt = Number.NEGATIVE_INFINITY;
  for (let pass = 0; ; pass++) {
    // Lets messages in.
    await new Promise((resolve) => setTimeout(resolve));
    const means = await onePass(
      { points, light: sky, sampler: light.sampler, hits, originOffset },
      tracer,
      perPass,
      seed,
      pass,
      stopped,
    );
    if (means === null || stopped()) return;
    sums.add(means);
    if (sums.numPasses < 2) continue;
    const enough = sums.numPasses * perPass * seen.samples ** 2 >= options.samplesPerPixel;
    if (!enough && performance.now() - sentAt < sendEveryMs) continue;
    const picture = sums.picture(perPass);
    const quiet = sums.numPasses >= leastPasses && picture.relativeError <= options.relativeError;
    answer({ kind: "picture", id, picture, done: enough || quiet }, buffersOf(picture));
    if (enough || quiet) return;
    sentAt = performance.now();
  }
}
