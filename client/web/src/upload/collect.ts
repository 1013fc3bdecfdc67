/** Dropped or chosen files as the files of one scene. */

import { BundleFault } from "../page/fault.js";
import { ZipArchive } from "../bundle/zip.js";
import { fillIn, texts } from "../words/words.js";

/** A file of a scene whose bytes are read when they are needed. */
export type SceneFile = {
  /** Inside the scene, with forward slashes. */
  readonly path: string;
  readonly sizeBytes: number;
  readonly read: () => Promise<Blob>;
};

/** A scene to be: its files, or one archive that only the server can open. */
export type Candidate =
  | { readonly kind: "files"; readonly name: string; readonly files: readonly SceneFile[] }
  | { readonly kind: "archive"; readonly name: string; readonly file: File; readonly mediaType: string };

/** The dropped files cannot be a scene; the message says what to do. */
export class NotAScene extends Error {
  override readonly name = "NotAScene";
}

const archives: ReadonlyMap<string, string> = new Map([
  [".tar", "application/x-tar"],
  [".tar.gz", "application/gzip"],
  [".tgz", "application/gzip"],
]);
const maxName = 100;

/** Return the candidate of files with paths such as "bowl/images/001.png", as folder choosers give them. */
export async function collect(chosen: ReadonlyMap<string, File>): Promise<Candidate> {
  const all = [...chosen].filter(([path]) => !path.split("/").some((part) => part.startsWith(".")));
  const [only] = all;
  if (only === undefined) throw new NotAScene(texts.upload.empty);
  const [path, file] = only;
  if (all.length === 1 && !path.includes("/")) {
    const name = file.name.toLowerCase();
    if (name.endsWith(".zip")) return zipped(file);
    for (const [suffix, mediaType] of archives) {
      if (name.endsWith(suffix)) return { kind: "archive", name: plainName(file.name), file, mediaType };
    }
    throw new NotAScene(fillIn(texts.upload.notAScene, { name: file.name }));
  }
  const { name, inside } = withoutTopFolder(all);
  const files = inside.map(([inner, each]) => ({
    path: inner,
    sizeBytes: each.size,
    read: () => Promise.resolve<Blob>(each),
  }));
  return {
    kind: "files",
    name: name === "" ? texts.upload.photographs : plainName(name),
    files: sorted(files),
  };
}

/** Return the files of a zip archive, each of which is unpacked when it is read. */
async function zipped(file: File): Promise<Candidate> {
  let archive: ZipArchive;
  try {
    archive = await ZipArchive.ofFile(file);
  } catch (error) {
    if (!(error instanceof BundleFault)) throw error;
    if (error.code === "bundle.encrypted" || error.code === "bundle.not_a_plain_file") {
      throw new NotAScene(`"${file.name}": ${error.message}`);
    }
    // A large or unusual archive: the server has a reader that knows more kinds, and says what is wrong.
    return { kind: "archive", name: plainName(file.name), file, mediaType: "application/zip" };
  }
  const entries = [...archive.entries]
    .filter(([path]) => !path.split("/").some((part) => part.startsWith(".") || part === "__MACOSX"))
    .map(([path, { sizeBytes }]) => [path, { stored: path, sizeBytes }] as const);
  if (entries.length === 0) throw new NotAScene(fillIn(texts.upload.emptyArchive, { name: file.name }));
  const files = withoutTopFolder(entries).inside.map(([path, { stored, sizeBytes }]) => ({
    path,
    sizeBytes,
    read: async () => new Blob([await archive.file(stored)]),
  }));
  return { kind: "files", name: plainName(file.name), files: sorted(files) };
}

/** Remove the folder that contains everything, if there is one. */
function withoutTopFolder<T>(entries: readonly (readonly [string, T])[]): {
  name: string;
  inside: (readonly [string, T])[];
} {
  const top = entries[0]![0].split("/")[0]!;
  if (!entries.every(([path]) => path.startsWith(`${top}/`))) return { name: "", inside: [...entries] };
  return { name: top, inside: entries.map(([path, value]) => [path.slice(top.length + 1), value] as const) };
}

function plainName(name: string): string {
  const whole = name.replace(/\.(zip|tar|tgz|tar\.gz)$/i, "");
  // biome-ignore lint/suspicious/noControlCharactersInRegex: the server refuses them in a name
  return whole.replace(/[\u0000-\u001f\u007f]/g, "").slice(0, maxName) || texts.upload.scene;
}

function sorted(files: readonly SceneFile[]): SceneFile[] {
  return [...files].sort((a, b) => (a.path < b.path ? -1 : 1));
}
