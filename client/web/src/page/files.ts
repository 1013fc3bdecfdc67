/** Dropped or chosen files by their paths. */

/** Return the files of a folder chooser, or of one for single files, by their paths. */
export function chosenFiles(list: Iterable<File>): Map<string, File> {
  return new Map([...list].map((file) => [file.webkitRelativePath || file.name, file]));
}

/** Return what was dropped. Must be called while the drop is handled: items are gone after any wait. */
export function droppedEntries(items: Iterable<DataTransferItem>): FileSystemEntry[] {
  return [...items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
}

/** Return the files of what was dropped, folders opened. */
export async function filesIn(entries: readonly FileSystemEntry[]): Promise<Map<string, File>> {
  const found = new Map<string, File>();
  for (const entry of entries) await walk(entry, found);
  return found;
}

async function walk(entry: FileSystemEntry, found: Map<string, File>): Promise<void> {
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) =>
      (entry as FileSystemFileEntry).file(resolve, reject),
    );
    found.set(entry.fullPath.replace(/^\//, ""), file);
    return;
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader();
  for (;;) {
    // A folder is read in batches; an empty one ends it.
    const some = await new Promise<FileSystemEntry[]>((resolve, reject) =>
      reader.readEntries(resolve, reject),
    );
    if (some.length === 0) return;
    for (const each of some) await walk(each, found);
  }
}
