/** Traces secondary rays: against the mesh, or with the trained fast cache, whose graph onnxruntime-web runs. */

import type { BundleManifest } from "../contract/lambent_proto/v1/bundle_pb.js";
import { type AtlasMesh, boundsOf } from "../bundle/mesh.js";
import type { PackedTransport } from "../bundle/transport.js";
import { type OnnxGraph, openGraph } from "../engine/onnxGraphs.js";
import { withoutHalves } from "../engine/onnxModel.js";
import { MeshRays } from "./meshRays.js";
import type { Backend } from "./status.js";
import { deviceFaults, fillIn } from "../words/words.js";

/** Opacity and distance of rays, one number each, and the texels that were met where those are known. */
export type Traced = {
  readonly opacity: Float32Array;
  readonly distance: Float32Array;
  readonly texel?: Uint32Array;
};

/** The light-independent answers to rays. */
export type Tracer = {
  readonly backend: Backend;
  /** Rays start this far along the normal, scene units. */
  readonly originOffset: number;
  /** Whether the CPU does the work, even under the name of another backend. */
  readonly slow: boolean;
  /** Rays that one call should have, so that none takes long. */
  readonly raysPerCall: number;
  /** Return the hits of rays; `rays` holds origin and unit direction, six floats each. */
  readonly trace: (rays: Float32Array<ArrayBuffer>) => Promise<Traced>;
};

/** No backend works for the fast cache; the message says why, for display. */
export class RefineFault extends Error {
  override readonly name = "RefineFault";
}

/** A tracer, and why it is not a faster one ("" where there is none). */
export type OpenedTracer = { readonly tracer: Tracer; readonly note: string };

type Bytes = Uint8Array<ArrayBuffer>;
/** A fast cache as it lies in a bundle. */
export type CacheFiles = {
  readonly manifest: BundleManifest;
  readonly model: Bytes;
  readonly weights: Bytes;
};

/** Rays start this far above a mesh, as a share of its size: rounding is a hundredth of it. */
const meshOffset = 1e-4;
const slowMs = 250;
const quickMs = 60;
const [leastRays, mostRays] = [1024, 65536];
const outputs = ["opacity", "distance"];

/** Return a tracer of exact rays against a mesh, which needs no networks and is the same in every browser. */
export function openMesh(mesh: AtlasMesh, { texelPlane, size }: PackedTransport): Tracer {
  const rays = new MeshRays(mesh);
  const { boundsMin, boundsMax } = boundsOf(mesh.positionsXyz);
  const diagonal = Math.hypot(...boundsMin.map((low, axis) => boundsMax[axis]! - low));
  const { uv, indices } = mesh;
  const inside = (place: number): number => Math.min(Math.max(Math.floor(place * size), 0), size - 1);
  const texelAt = (face: number, u: number, v: number): number => {
    const [a, b, c] = [indices[3 * face]!, indices[3 * face + 1]!, indices[3 * face + 2]!];
    const at = (axis: 0 | 1): number =>
      (1 - u - v) * uv[2 * a + axis]! + u * uv[2 * b + axis]! + v * uv[2 * c + axis]!;
    return texelPlane[inside(at(1)) * size + inside(at(0))]!;
  };
  return paced("mesh", false, meshOffset * diagonal, async (given) => {
    const count = given.length / 6;
    const [opacity, distance] = [new Float32Array(count), new Float32Array(count)];
    const texel = new Uint32Array(count);
    for (let ray = 0, at = 0; ray < count; ray++, at += 6) {
      const far = rays.distance(
        given[at]!,
        given[at + 1]!,
        given[at + 2]!,
        given[at + 3]!,
        given[at + 4]!,
        given[at + 5]!,
      );
      distance[ray] = far;
      if (rays.face < 0) continue;
      opacity[ray] = 1;
      texel[ray] = texelAt(rays.face, rays.u, rays.v);
    }
    // Lets messages in, of which one may say stop.
    await new Promise((resolve) => setTimeout(resolve));
    return { opacity, distance, texel };
  });
}

/**
 * Open a tracer of a fast cache: "cache" takes graphics hardware where it works, else the processor and says why. Throws
 * RefineFault where what is wanted does not work here.
 */
export async function openCache(
  files: CacheFiles,
  wanted: "cache" | "webgpu" | "wasm",
): Promise<OpenedTracer> {
  let reason = "";
  if (wanted !== "wasm") {
    try {
      const adapter = await navigator.gpu?.requestAdapter().catch(() => null);
      if (!adapter) throw new RefineFault(deviceFaults.noWebgpu);
      // Far slower than WebAssembly, where both run on the processor.
      if (wanted === "cache" && adapter.info.isFallbackAdapter)
        throw new RefineFault(deviceFaults.softWebgpu);
      return { tracer: await openWebgpu(adapter, files), note: "" };
    } catch (error) {
      reason = firstLine(error);
      if (wanted === "webgpu") throw new RefineFault(fillIn(deviceFaults.tryAnother, { reason }));
    }
  }
  try {
    return { tracer: await openWasm(files), note: reason };
  } catch (error) {
    const { noWasm } = deviceFaults;
    const reasons = reason === "" ? noWasm : fillIn(deviceFaults.and, { one: reason, other: noWasm });
    throw new RefineFault(fillIn(deviceFaults.noTracer, { reasons, detail: firstLine(error) }));
  }
}

async function openWebgpu(adapter: GPUAdapter, { manifest, model, weights }: CacheFiles): Promise<Tracer> {
  // The graph's tables are halves, with which not all graphics hardware computes.
  const stored = adapter.features.has("shader-f16") ? { model, weights } : withoutHalves(model, weights);
  const runtime = await import("onnxruntime-web/webgpu");
  const graph = await openGraph(stored.model, stored.weights, { provider: "webgpu", runtime, outputs }).catch(
    (error: unknown) => {
      throw new RefineFault(fillIn(deviceFaults.webgpuRefused, { detail: firstLine(error) }));
    },
  );
  // A call to hardware that is lost never ends by itself.
  const { lost } = (await runtime.env.webgpu.device) as GPUDevice;
  const gone = lost.then(({ message }) => {
    throw new Error(message || deviceFaults.lost);
  });
  gone.catch(() => {});
  return paced("webgpu", adapter.info.isFallbackAdapter, offsetOf(manifest), (rays) =>
    Promise.race([ask(graph, rays), gone]).catch((error: unknown) => {
      throw new RefineFault(fillIn(deviceFaults.webgpuFailed, { detail: firstLine(error) }));
    }),
  );
}

async function openWasm({ manifest, model, weights }: CacheFiles): Promise<Tracer> {
  // 4 MB to fetch, which no page should carry that does not refine.
  const runtime = await import("onnxruntime-web/wasm");
  const graph = await openGraph(model, weights, { provider: "wasm", runtime, outputs });
  return paced("wasm", true, offsetOf(manifest), async (rays) => {
    const answers = await ask(graph, rays);
    // This runtime never waits for anything; this lets messages in, of which one may say stop.
    await new Promise((resolve) => setTimeout(resolve));
    return answers;
  });
}

/** Return what a graph answers to rays of six floats each. */
async function ask(graph: OnnxGraph, rays: Float32Array): Promise<Traced> {
  const count = rays.length / 6;
  const [origin, direction] = [new Float32Array(3 * count), new Float32Array(3 * count)];
  for (let ray = 0; ray < count; ray++) {
    origin.set(rays.subarray(6 * ray, 6 * ray + 3), 3 * ray);
    direction.set(rays.subarray(6 * ray + 3, 6 * ray + 6), 3 * ray);
  }
  const found = await graph.run({ origin, direction }, { origin: 3, direction: 3 });
  return { opacity: found.opacity!, distance: found.distance! };
}

/** Return the first line of what went wrong, short enough for a panel. */
function firstLine(error: unknown): string {
  const { message } = Object(error) as { readonly message?: unknown };
  return (typeof message === "string" ? message : String(error)).split("\n")[0]!.slice(0, 200);
}

function offsetOf(manifest: BundleManifest): number {
  return manifest.secondaryRays?.originOffset ?? 0;
}

/** Find out how many rays a call may have: longer calls waste less, but nothing can be stopped during one. */
function paced(
  backend: Backend,
  slow: boolean,
  originOffset: number,
  run: (rays: Float32Array<ArrayBuffer>) => Promise<Traced>,
): Tracer {
  const tracer = {
    ...{ backend, slow, originOffset, raysPerCall: leastRays },
    trace: async (rays: Float32Array<ArrayBuffer>): Promise<Traced> => {
      if (rays.length === 0) return { opacity: new Float32Array(0), distance: new Float32Array(0) };
      const start = performance.now();
      const answers = await run(rays);
      const took = performance.now() - start;
      if (took > slowMs) tracer.raysPerCall = Math.max(tracer.raysPerCall / 2, leastRays);
      else if (took < quickMs && rays.length >= 3 * tracer.raysPerCall) {
        tracer.raysPerCall = Math.min(2 * tracer.raysPerCall, mostRays);
      }
      return answers;
    },
  };
  return tracer;
}
