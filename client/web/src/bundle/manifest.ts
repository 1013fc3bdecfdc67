/** Reading manifest.json and the files it lists, with the checks of `lambent_relight.bundle.bundle`. */

import { fromJsonString } from "@bufbuild/protobuf";
import { type BundleManifest, BundleManifestSchema } from "../contract/lambent_proto/v1/bundle_pb.js";
import { BundleFault, exportAgain, fetchAgain, unsafe } from "../page/fault.js";
import { sha256Hex } from "../page/buffers.js";
import type { FileSource } from "./source.js";
import { bundleFaults, fillIn } from "../words/words.js";

/** The version of the format that is read. */
const formatVersion = "1";
const manifestLimit = 16 << 20;
const fileLimit = 512 << 20;
/**
 * Share of a file from which its beginning is read out of an answer with all of it: hosts compress that, but no parts.
 */
const streamedShare = 0.25;
/** Texels along a side of the largest atlas that is written. */
export const maxAtlasSize = 8192;
const conventions = {
  upAxis: ["up_axis", "z"],
  handedness: ["handedness", "right"],
  environmentConvention: ["environment_convention", "tensoir"],
  radiance: ["radiance", "linear-rec709"],
} as const;

/** A bundle whose manifest has been checked; files are checked when they are read. */
export type OpenBundle = {
  readonly manifest: BundleManifest;
  /** Return a listed file's bytes, of the stated size and digest; throws BundleFault otherwise. */
  readonly read: (path: string) => Promise<Uint8Array<ArrayBuffer>>;
  /**
   * Return the first bytes of a listed file, which are checked with all of it; all where parts save nothing. A large
   * share of a file is asked for after `others`, files that are waited for as well: the rest of it comes at once.
   */
  readonly begin: (path: string, bytes: number, others: () => Promise<unknown>) => Promise<Beginning>;
};

/** The part of a file that was read, and what reads all of it; null if the part is all. */
export type Beginning = {
  readonly data: Uint8Array<ArrayBuffer>;
  readonly whole: (() => Promise<Uint8Array<ArrayBuffer>>) | null;
};

/** Read and check the manifest behind a source. */
export async function openBundle(source: FileSource): Promise<OpenBundle> {
  const manifest = parseManifest(await source.read("manifest.json", manifestLimit));
  checkVersion(manifest);
  checkFiles(manifest, source.paths);
  checkValues(manifest);
  const files = new Map(manifest.files.map((file) => [file.path, file]));
  const listed = (path: string) => {
    const stated = files.get(path);
    if (stated === undefined)
      throw exportAgain("bundle.file_missing", fillIn(bundleFaults.unlisted, { path }));
    return stated;
  };
  const checked = async (path: string, data: Uint8Array<ArrayBuffer>) => {
    const { sizeBytes, sha256 } = listed(path);
    if (data.length === sizeBytes && (await sha256Hex(data)) === sha256) return data;
    throw fetchAgain("bundle.digest_mismatch", fillIn(bundleFaults.otherFile, { path }));
  };
  const read = async (path: string): Promise<Uint8Array<ArrayBuffer>> => {
    listed(path);
    return checked(path, await source.read(path, fileLimit));
  };
  const begin = async (path: string, bytes: number, others: () => Promise<unknown>): Promise<Beginning> => {
    const { parts } = source;
    const { sizeBytes } = listed(path);
    if (parts === undefined || bytes >= sizeBytes) return { data: await read(path), whole: null };
    if (bytes >= streamedShare * sizeBytes) {
      await others();
      const { data, whole } = await parts.stream(path, bytes, fileLimit);
      whole.catch(() => {}); // Told to whoever waits for it.
      return { data, whole: async () => checked(path, await whole) };
    }
    const data = await parts.head(path, bytes, fileLimit);
    // A host without parts has sent everything.
    if (data.length !== bytes) return { data: await checked(path, data), whole: null };
    return { data, whole: () => read(path) };
  };
  return { manifest, read, begin };
}

function parseManifest(data: Uint8Array): BundleManifest {
  try {
    const text = new TextDecoder("utf-8", { fatal: true }).decode(data);
    return fromJsonString(BundleManifestSchema, text, { ignoreUnknownFields: true });
  } catch (error) {
    const reason = error instanceof Error ? error.message.split("\n")[0]!.slice(0, 200) : bundleFaults.noText;
    throw fetchAgain("bundle.manifest_unreadable", fillIn(bundleFaults.manifestUnreadable, { reason }));
  }
}

function checkVersion(manifest: BundleManifest): void {
  if (manifest.schemaVersion !== formatVersion) {
    throw new BundleFault(
      "bundle.version_unknown",
      fillIn(bundleFaults.unknownVersion, {
        version: manifest.schemaVersion.slice(0, 32),
        known: formatVersion,
      }),
    );
  }
}

/** Throw unless a path is a plain relative path inside the bundle, with forward slashes. */
export function checkPath(path: string): void {
  const parts = path.split("/");
  const plain = parts.every((part) => part !== "" && part !== "." && part !== "..");
  if (!plain || /[\\:\0]/.test(path) || path.length > 1024) {
    throw unsafe("bundle.path_unsafe", fillIn(bundleFaults.leavesBundle, { path: path.slice(0, 200) }));
  }
}

function checkFiles(manifest: BundleManifest, present: ReadonlySet<string> | null): void {
  const stated = new Set(manifest.files.map((file) => file.path));
  if (manifest.files.length > 4096) {
    throw unsafe("bundle.too_many_files", fillIn(bundleFaults.tooManyFiles, { most: 4096 }));
  }
  for (const path of stated) checkPath(path);
  if (stated.size !== manifest.files.length)
    throw exportAgain("bundle.manifest_invalid", bundleFaults.listedTwice);
  if (present === null) return;
  for (const path of present) checkPath(path);
  const missing = [...stated].filter((path) => !present.has(path));
  const extra = [...present].filter((path) => path !== "manifest.json" && !stated.has(path));
  if (missing.length > 0) {
    throw fetchAgain(
      "bundle.file_missing",
      fillIn(bundleFaults.filesMissing, { paths: missing.slice(0, 4).join(", ") }),
    );
  }
  if (extra.length > 0) {
    throw new BundleFault(
      "bundle.file_unlisted",
      fillIn(bundleFaults.filesUnlisted, { paths: extra.slice(0, 4).join(", ") }),
    );
  }
}

function checkValues(manifest: BundleManifest): void {
  for (const [field, [name, expected]] of Object.entries(conventions)) {
    const found = manifest.world?.[field as keyof typeof conventions] ?? "";
    if (found !== expected) {
      throw new BundleFault(
        "bundle.convention_unknown",
        fillIn(bundleFaults.convention, { name, found: found.slice(0, 64), expected }),
      );
    }
  }
  const [low, high] = [manifest.bounds?.minimum ?? [], manifest.bounds?.maximum ?? []];
  const ordered = low.every((value, axis) => Number.isFinite(value) && value < high[axis]!);
  if (low.length !== 3 || high.length !== 3 || !ordered || !high.every(Number.isFinite)) {
    throw exportAgain("bundle.manifest_invalid", bundleFaults.bounds);
  }
  const scale = manifest.albedoScaleRgb;
  if (scale.length !== 3 || !scale.every((value) => value > 0 && Number.isFinite(value))) {
    throw exportAgain("bundle.manifest_invalid", bundleFaults.albedoScale);
  }
  const { size = 0, materialSize = 0, texelSize = 0 } = manifest.atlas ?? {};
  const sizes = [size, materialSize].every((texels) => texels >= 1 && texels <= maxAtlasSize);
  if (manifest.transport !== undefined && !(sizes && texelSize > 0 && Number.isFinite(texelSize))) {
    throw exportAgain("bundle.manifest_invalid", fillIn(bundleFaults.atlas, { most: maxAtlasSize }));
  }
}
