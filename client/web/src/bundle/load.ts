/** Reads and checks the parts of a bundle that a viewer needs. */

import type { Atlas, BundleManifest, Transport } from "../contract/lambent_proto/v1/bundle_pb.js";
import { type PhotoCamera, parseCameras } from "./cameras.js";
import { BundleFault, exportAgain } from "../page/fault.js";
import { type OpenBundle, openBundle } from "./manifest.js";
import { type AtlasMesh, boundsOf, meshFromGlb, texturesFromGlb } from "./mesh.js";
import { type BundleOrigin, openSource } from "./source.js";
import { type FinerTables, finerTables, type PackedTransport, readTransport } from "./transport.js";
import { readUncertainty, type UncertaintyGrid } from "./uncertainty.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** A file of the bundle, as it is. */
export type BundlePicture = { readonly name: string; readonly data: Uint8Array<ArrayBuffer> };

/** The mesh's textures as pictures, rows from the top. */
export type MaterialMaps = {
  /** sRGB-encoded. */
  readonly albedo: ImageBitmap;
  /** Occlusion, perceptual roughness and metalness. */
  readonly packed: ImageBitmap;
  /** Normals in the frames of the tangents, -1..1 as 0..255. */
  readonly normal: ImageBitmap;
};

/** Decodes a PNG file, its levels as they are stored. */
export type Decode = (png: Uint8Array<ArrayBuffer>) => Promise<ImageBitmap>;

/** A bundle in memory; only typed arrays, pictures and plain values, so that a worker can send it. */
export type LoadedBundle = Readonly<Pick<BundleManifest, "name" | "sceneId" | "preset">> & {
  /** The mesh's box, scene units. */
  readonly boundsMin: readonly number[];
  readonly boundsMax: readonly number[];
  readonly albedoScaleRgb: readonly number[];
  readonly metrics: Readonly<Record<string, number>>;
  readonly trainLights: readonly string[];
  /** About fast caches that were adapted to one light, which no viewer uses; empty where there are none. */
  readonly adaptedNote: string;
  readonly mesh: AtlasMesh;
  /** The materials of what is seen. */
  readonly maps: MaterialMaps;
  /** White where no photograph shows the surface; null where all of it is shown, or that is not known. */
  readonly unseen: ImageBitmap | null;
  readonly transport: PackedTransport;
  readonly uncertainty: UncertaintyGrid | null;
  readonly cameras: readonly PhotoCamera[];
  /** env/trained_<light>.exr by light. */
  readonly trainedMaps: readonly BundlePicture[];
  /** Photographs of preview/ that a camera has the name of. */
  readonly previews: readonly BundlePicture[];
};

/** A bundle that can be shown, and a promise of the planes of its transport that it has not yet; null where it has all. */
export type ShownBundle = LoadedBundle & { readonly finer: Promise<FinerTables> | null };

/** Information sent before the whole bundle has been read, so that its light can be prepared meanwhile. */
export type BundleNews =
  | { readonly kind: "progress"; readonly readBytes: number; readonly totalBytes: number }
  | {
      readonly kind: "opened";
      readonly name: string;
      readonly totalBytes: number;
      readonly bands: number;
      /** Lights with a map. */
      readonly lights: readonly string[];
    }
  | { readonly kind: "map"; readonly map: BundlePicture };

/**
 * Read a bundle; `tell` receives information about it meanwhile. With `later` the bundle may have only the first planes
 * of its transport, those of a lite bundle; `later` is then called with what reads all of them. Throws BundleFault.
 */
export async function loadBundle(
  origin: BundleOrigin,
  tell: (news: BundleNews) => void,
  decode: Decode,
  later: ((finer: () => Promise<FinerTables>) => void) | null = null,
): Promise<LoadedBundle> {
  const bundle = await openBundle(await openSource(origin));
  const { manifest } = bundle;
  const stated = manifest.transport;
  if (stated === undefined) {
    throw new BundleFault("bundle.transport_missing", bundleFaults.noTransport);
  }
  // A manifest with transport has been checked for it.
  const atlas = manifest.atlas!;
  const shown = shownFiles(manifest, stated);
  const { lights, cameraPath, pictures, totalBytes } = shown;
  const bands = stated.planes.find(({ name }) => name === "direct")?.bands ?? 0;
  tell({ kind: "opened", name: manifest.name, totalBytes, bands, lights });
  const files = new CountedFiles(bundle, shown, later !== null, tell);
  const counted = (path: string, bytes?: number) => files.read(path, bytes);
  const trainedMap = async (name: string): Promise<BundlePicture> => {
    const map = { name, data: await counted(`env/trained_${name}.exr`) };
    tell({ kind: "map", map });
    return map;
  };
  const uncertainty = manifest.uncertainty;
  // The maps first: preparing light takes longest.
  const [trainedMaps, [mesh, maps], transport, grid, cameras, unseen, previews] = await Promise.all([
    Promise.all(lights.map(trainedMap)),
    counted("mesh/asset.glb").then(async (data) => {
      return [meshFromGlb(data), await mapsOf(data, atlas, decode)] as const;
    }),
    readTransport(stated, counted),
    uncertainty === undefined
      ? null
      : counted(uncertainty.path).then((data) => readUncertainty(uncertainty, data)),
    cameraPath === undefined ? [] : counted(cameraPath).then(parseCameras),
    atlas.unseenPath === "" ? null : counted(atlas.unseenPath).then((data) => maskOf(data, decode)),
    Promise.all(
      pictures.map(async (path) => ({ name: path.slice("preview/".length), data: await counted(path) })),
    ),
  ]);
  if (files.isPartial) later?.(() => finerTables(stated, (path) => files.whole(path)));
  const { name, sceneId, preset, albedoScaleRgb, metrics, trainLights } = manifest;
  return {
    name,
    sceneId,
    preset,
    albedoScaleRgb,
    metrics,
    trainLights,
    adaptedNote: adaptedNote(manifest),
    ...boundsOf(mesh.positionsXyz),
    mesh,
    maps,
    unseen,
    transport,
    uncertainty: grid,
    cameras,
    trainedMaps,
    previews,
  };
}

/** Return what a viewer reads of a bundle: paths by what they are for, and how many bytes that is. */
function shownFiles({ files, trainLights, uncertainty, atlas }: BundleManifest, transport: Transport) {
  const sizes = new Map(files.map((file) => [file.path, file.sizeBytes]));
  const lights = trainLights.filter((light) => sizes.has(`env/trained_${light}.exr`));
  const cameraPath = files.find((file) => file.role === "cameras")?.path;
  const pictures = files.filter((file) => file.path.startsWith("preview/")).map((file) => file.path);
  const wanted = [
    "mesh/asset.glb",
    transport.texelsPath,
    ...transport.planes.filter(({ name }) => name !== "material").map((planes) => planes.path),
    uncertainty?.path ?? "",
    atlas!.unseenPath,
    cameraPath ?? "",
    ...lights.map((light) => `env/trained_${light}.exr`),
    ...pictures,
  ];
  const totalBytes = wanted.reduce((sum, path) => sum + (sizes.get(path) ?? 0), 0);
  return { sizes, lights, cameraPath, pictures, totalBytes };
}

/** Files of a bundle, which tell of their bytes as they arrive. */
class CountedFiles {
  readonly #reading: Promise<unknown>[] = [];
  readonly #wholes = new Map<string, () => Promise<Uint8Array<ArrayBuffer>>>();
  #arrived = 0;

  constructor(
    private readonly bundle: OpenBundle,
    private readonly shown: ReturnType<typeof shownFiles>,
    /** Whether beginnings of files will do at first. */
    private readonly inParts: boolean,
    private readonly tell: (news: BundleNews) => void,
  ) {}

  /** Whether only the beginning of a file is there. */
  get isPartial(): boolean {
    return this.#wholes.size > 0;
  }

  /** Return a file, or its first `bytes` bytes; large beginnings come after the files that are read whole. */
  async read(path: string, bytes = Infinity): Promise<Uint8Array<ArrayBuffer>> {
    const { sizes, totalBytes } = this.shown;
    const reading =
      !this.inParts || bytes === Infinity
        ? this.bundle.read(path).then((all) => ({ data: all, whole: null }))
        : this.bundle.begin(path, bytes, () => Promise.allSettled(this.#reading));
    if (bytes === Infinity) this.#reading.push(reading);
    const { data, whole } = await reading;
    if (whole !== null) this.#wholes.set(path, whole);
    // What comes later is not waited for.
    this.#arrived += whole === null ? data.length : (sizes.get(path) ?? 0);
    this.tell({ kind: "progress", readBytes: this.#arrived, totalBytes });
    return data;
  }

  /** Return all of a file. */
  whole(path: string): Promise<Uint8Array<ArrayBuffer>> {
    return this.#wholes.get(path)?.() ?? this.bundle.read(path);
  }
}

async function maskOf(png: Uint8Array<ArrayBuffer>, decode: Decode): Promise<ImageBitmap> {
  try {
    return await decode(png);
  } catch {
    throw exportAgain("bundle.mesh_invalid", bundleFaults.unseenDamaged);
  }
}

/** Return the textures of a mesh as pictures; sizes are compared before anything is decoded. */
async function mapsOf(glb: Uint8Array<ArrayBuffer>, atlas: Atlas, decode: Decode): Promise<MaterialMaps> {
  const files = texturesFromGlb(glb);
  for (const [{ width, height }, stated] of [
    [files.baseColour, atlas.size],
    [files.packed, atlas.materialSize],
    [files.normal, atlas.materialSize],
  ] as const) {
    if (width !== stated || height !== stated) {
      throw exportAgain(
        "bundle.mesh_invalid",
        fillIn(bundleFaults.mesh, { what: fillIn(bundleFaults.textureSize, { width, height, stated }) }),
      );
    }
  }
  try {
    const [albedo, packed, normal] = await Promise.all([
      decode(files.baseColour.data),
      decode(files.packed.data),
      decode(files.normal.data),
    ]);
    return { albedo, packed, normal };
  } catch {
    throw exportAgain(
      "bundle.mesh_invalid",
      fillIn(bundleFaults.mesh, { what: bundleFaults.textureDamaged }),
    );
  }
}

/**
 * Return the note about fast caches that were adapted to one light, empty if there are none: Python's `refined` may take
 * their radiance, refining here does not.
 */
export function adaptedNote({ graphs, trainLights }: Pick<BundleManifest, "graphs" | "trainLights">): string {
  const adapted = graphs.filter(({ name, light }) => name === "fast_cache" && !trainLights.includes(light));
  if (adapted.length === 0) return "";
  const names = adapted.map(({ light }) => light.slice(0, 40)).join(", ");
  return fillIn(bundleFaults.adapted, { lights: names });
}

/** Give back the memory of a bundle's pictures: browsers do that late by themselves, and seldom know how much it is. */
export function closePictures({ maps, unseen }: Pick<LoadedBundle, "maps" | "unseen">): void {
  for (const each of [maps.albedo, maps.packed, maps.normal, unseen]) each?.close();
}
