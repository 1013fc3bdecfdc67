/** Refines pictures in a worker. */

import { BundleFault } from "../page/fault.js";
import { openBundle } from "../bundle/manifest.js";
import { openSource } from "../bundle/source.js";
import { forHits } from "../bundle/transport.js";
import { bouncedCoefficients, type FallingLight } from "../engine/fallingLight.js";
import { buffersOf, sharedCopy } from "../page/buffers.js";
import type { PreparedLight } from "../light/prepare.js";
import { Accumulation } from "./accumulation.js";
import { Hits, HitScene } from "./hitRadiance.js";
import { LightSampler } from "./lightSampler.js";
import { denoised, type PixelFeatures } from "./denoise.js";
import type {
  OpenQuestion,
  RefineAnswer,
  RefineQuestion,
  SharedPass,
  SharedTables,
  StartQuestion,
  WorkerShare,
} from "./messages.js";
import { onePass } from "./passes.js";
import { pixelFeatures } from "./pixelFeatures.js";
import { brightness, SkyLight } from "./skyLight.js";
import { type SurfacePoints, surfacePoints } from "./surfacePoints.js";
import { type CacheFiles, openCache, openMesh, RefineFault, type Tracer } from "./tracer.js";
import { bundleFaults } from "../words/words.js";
import { workerSpeaks } from "../words/languages.js";

/** Directions of a point in one pass. */
const perPass = 8;
/** Passes before their differences say anything about the noise. */
const leastPasses = 4;
/** Pictures that are shown before are sent at most so often, ms. */
const sendEveryMs = 250;
const seed = 1;

type Opened = { readonly tracer: Tracer; readonly scene: HitScene; readonly share: WorkerShare };
type Light = { readonly levels: PreparedLight["levels"]; readonly sampler: LightSampler };

let opened: Opened | null = null;
let light: Light | null = null;
let current = 0;
let taking: ((pass: SharedPass) => void) | null = null;
let work: Promise<void> = workerSpeaks();

function answer(message: RefineAnswer, transfer: Transferable[] = []): void {
  self.postMessage(message, { transfer });
}

self.onmessage = ({ data }: MessageEvent<RefineQuestion>) => {
  if (data.ask === "stop") {
    // A picture that was done late must not end the next one.
    if (data.id === undefined || data.id === current) current = 0;
    return;
  }
  current = data.ask === "start" ? data.id : 0;
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

async function open(question: OpenQuestion): Promise<void> {
  const { mesh, transport, share } = question;
  if (share.index > 0) {
    const tracer = openMesh(mesh, transport);
    // The first one reads what there is to read.
    const tables = await tablesFrom(share.ports[0]!);
    opened = { tracer, scene: new HitScene({ ...transport, ...tables }, mesh), share };
    answer({ kind: "opened", backend: tracer.backend, note: "", slow: tracer.slow });
    return;
  }
  const { origin, sceneId, backend } = question;
  const files = await openBundle(await openSource(origin));
  const { manifest } = files;
  const stated = manifest.transport;
  if (manifest.sceneId !== sceneId || stated === undefined) {
    throw new BundleFault("bundle.digest_mismatch", bundleFaults.changed);
  }
  const { material, shadowBits } = await forHits(transport, stated, files.read);
  const isShared = share.ports.length > 0 && globalThis.crossOriginIsolated;
  const read: SharedTables = { material, shadowBits };
  const tables = isShared ? sharedCopy(read) : read;
  for (const port of share.ports) {
    port.onmessage = ({ data }: MessageEvent<SharedPass>) => taking?.(data);
    port.postMessage(tables);
  }
  let [tracer, note] = [null as Tracer | null, ""];
  if (backend === "mesh") tracer = openMesh(mesh, transport);
  else ({ tracer, note } = await openCache(await cacheFiles(files), backend));
  opened = { tracer, scene: new HitScene({ ...transport, ...tables }, mesh), share };
  answer({ kind: "opened", backend: tracer.backend, note, slow: tracer.slow });
}

function tablesFrom(port: MessagePort): Promise<SharedTables> {
  return new Promise((resolve) => {
    port.onmessage = ({ data }: MessageEvent<SharedTables>) => resolve(data);
  });
}

/** Fetch and check a fast cache; any of them will do, since no light changes what rays hit. */
async function cacheFiles({ manifest, read }: Awaited<ReturnType<typeof openBundle>>): Promise<CacheFiles> {
  const graph = manifest.graphs.find(({ name }) => name === "fast_cache");
  if (graph === undefined) {
    throw new BundleFault("bundle.graph_missing", bundleFaults.noNetworks);
  }
  const [model, weights] = await Promise.all([read(graph.path), read("models/weights.bin")]);
  return { manifest, model, weights };
}

async function refine(question: StartQuestion): Promise<void> {
  const { id, seen } = question;
  const stopped = (): boolean => current !== id;
  if (opened === null || stopped()) return;
  const { levels } = question;
  if (levels !== null) light = { levels, sampler: new LightSampler(brightness(levels)) };
  if (light === null) throw new Error("a picture without light was asked for");
  const { tracer, scene, share } = opened;
  const sky = new SkyLight(light.levels, question.turn, question.intensity);
  const points = surfacePoints(seen, question.edit);
  const falling = scene.transport.shadowBits === null ? whole(question.falling) : question.falling;
  const hits = question.indirect ? new Hits(scene, sky, falling, question.edit) : null;
  const { originOffset } = tracer;
  const lit = { points, light: sky, sampler: light.sampler, hits, originOffset };
  const collector = share.index === 0 ? new Collector(question, points) : null;
  if (collector !== null) {
    taking = (pass) => {
      if (pass.id === id) collector.sums.add(pass.means);
    };
  }
  for (let pass = share.index; ; pass += share.count) {
    // Lets messages in.
    await new Promise((resolve) => setTimeout(resolve));
    const means = await onePass(lit, tracer, perPass, seed, pass, stopped);
    if (means === null || stopped()) return;
    if (collector === null) {
      share.ports[0]!.postMessage({ id, means } satisfies SharedPass, buffersOf(means));
      continue;
    }
    collector.sums.add(means);
    if (await collector.tell(stopped)) return;
  }
}

/** Return a light with its dominant lights among the harmonics: without bits their shadows are not known at texels. */
function whole(light: FallingLight): FallingLight {
  return {
    ...light,
    coefficientsRgb: bouncedCoefficients(light, light.bands),
    directions: [],
    irradianceRgb: [],
  };
}

/** Adds the passes of one picture up, and sends it. */
class Collector {
  readonly sums: Accumulation;
  readonly #features: PixelFeatures;
  #isFirst = true;
  #sentAt = Number.NEGATIVE_INFINITY;
  /** A picture is smoothed again when it has so many passes: that takes longer than one of them. */
  #smoothAt = 0;

  constructor(
    private readonly question: StartQuestion,
    points: SurfacePoints,
  ) {
    const { seen } = question;
    this.sums = new Accumulation(points, seen.camera, seen.samples);
    this.#features = pixelFeatures(points, seen);
  }

  /** Send the picture if it is time; returns whether it is good enough, or not wanted any more. */
  async tell(stopped: () => boolean): Promise<boolean> {
    const { id, options, seen } = this.question;
    const { numPasses } = this.sums;
    if (numPasses < 2) return false;
    const enough = numPasses * perPass * seen.samples ** 2 >= options.samplesPerPixel;
    const early = options.denoise
      ? numPasses < this.#smoothAt
      : performance.now() - this.#sentAt < sendEveryMs;
    if (!enough && early) return false;
    const picture = this.sums.picture(perPass);
    const quiet = numPasses >= leastPasses && picture.relativeError <= options.relativeError;
    const shown = options.denoise ? await denoised(picture, this.#features, stopped) : null;
    if (stopped()) return true;
    const done = enough || quiet;
    this.#sentAt = performance.now();
    this.#smoothAt = 2 * numPasses;
    // The denoiser keeps its own.
    const features = this.#isFirst ? structuredClone(this.#features) : null;
    this.#isFirst = false;
    answer(
      { kind: "picture", id, picture, shown, features, done },
      buffersOf({ picture, shown, features }) as ArrayBuffer[],
    );
    return done;
  }
}
