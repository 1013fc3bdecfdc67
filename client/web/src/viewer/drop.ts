/** Files that are dropped or chosen: a bundle, its folder, or a map. */

import type { BundleOrigin } from "../bundle/source.js";
import { chosenFiles, droppedEntries, filesIn } from "../page/files.js";

export type DroppedBundle = Exclude<BundleOrigin, { kind: "url" }>;

export type Dropped = DroppedBundle | { readonly kind: "map"; readonly file: File };

/** Return the kind of a list of files, or null if it is unknown. */
export function droppedFiles(files: readonly File[]): Dropped | null {
  if (files.length > 1) return { kind: "files", files: chosenFiles(files) };
  const file = files[0];
  if (file === undefined) return null;
  if (/\.zip$/i.test(file.name)) return { kind: "archive", file };
  return /\.(hdr|exr|pic|rgbe)$/i.test(file.name) ? { kind: "map", file } : null;
}

/** Return the dropped item; folders are read recursively. */
export async function readDrop(transfer: DataTransfer): Promise<Dropped | null> {
  const entries = droppedEntries(transfer.items);
  const inFolder = entries.some((entry) => entry.isDirectory);
  return inFolder ? { kind: "files", files: await filesIn(entries) } : droppedFiles([...transfer.files]);
}

/** Let the person choose files. */
export function chooseFiles(accept: string, folder: boolean): Promise<File[]> {
  const input = document.createElement("input");
  input.type = "file";
  input.accept = accept;
  input.webkitdirectory = folder;
  return new Promise((resolve) => {
    input.addEventListener("change", () => resolve([...(input.files ?? [])]));
    input.addEventListener("cancel", () => resolve([]));
    input.click();
  });
}
