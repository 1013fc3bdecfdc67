/** Files that are dropped or chosen: a bundle, its folder, or a map. */

/** The dropped item. */
export type Dropped =
  | { readonly kind: "archive"; readonly file: File }
  | { readonly kind: "folder"; readonly files: ReadonlyMap<string, Blob> }
  | { readonly kind: "map"; readonly file: File };

/** Return the kind of a list of files, or null if it is unknown. */
export function droppedFiles(files: readonly File[]): Dropped | null {
  if (files.length > 1) {
    const paths = new Map(files.map((file) => [file.webkitRelativePath || file.name, file as Blob]));
    return { kind: "folder", files: paths };
  }
  const file = files[0];
  if (file === undefined) return null;
  if (/\.zip$/i.test(file.name)) return { kind: "archive", file };
  if (/\.(hdr|exr|pic|rgbe)$/i.test(file.name)) return { kind: "map", file };
  return null;
}

/** Return the dropped item; folders are read recursively. */
export async function readDrop(transfer: DataTransfer): Promise<Dropped | null> {
  const entries = [...transfer.items]
    .map((item) => item.webkitGetAsEntry())
    .filter((entry) => entry !== null);
  const plain = [...transfer.files];
  if (!entries.some((entry) => entry.isDirectory)) return droppedFiles(plain);
  const files = new Map<string, Blob>();
  for (const entry of entries) await collect(entry, files);
  return { kind: "folder", files };
}

async function collect(entry: FileSystemEntry, into: Map<string, Blob>): Promise<void> {
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => {
      (entry as FileSystemFileEntry).file(resolve, reject);
    });
    into.set(entry.fullPath.replace(/^\//, ""), file);
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) => {
      reader.readEntries(resolve, reject);
    });
    if (some.length === 0) return;
    for (const each of some) await collect(each, into);
  }
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
