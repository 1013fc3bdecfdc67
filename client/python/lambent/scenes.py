"""Uploading a scene: plan, send what is missing, commit. Run again, it sends only what is still missing."""

import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from lambent_core.files import file_sha256

from lambent.connection import Connection, TransferProgress, ignore_progress
from lambent.direct import DirectSender, LocalFile, NoWayError, is_store_away, patiently
from lambent.errors import RefusedError, UsageProblemError
from lambent.models import FileEntry, Scene

ARCHIVES = {
    ".zip": "application/zip",
    ".tar": "application/x-tar",
    ".tar.gz": "application/gzip",
    ".tgz": "application/gzip",
}


def list_files(folder: Path, progress: TransferProgress = ignore_progress) -> tuple[FileEntry, ...]:
    """Return every file of a scene folder, sorted by path, with sizes and hashes.

    Names that begin with a dot are left out. Symbolic links are followed as long as they stay in the folder;
    others are refused (`scene.link`).
    """
    if not folder.is_dir():
        raise UsageProblemError(
            "scene.not_a_folder", f"{folder} is not a folder or archive", "give the folder of one scene"
        )
    paths = list(_files(folder, folder.resolve(), ()))
    if not paths:
        raise UsageProblemError("scene.empty", f"{folder} holds no files", "give the folder of one scene")
    total_bytes = sum(path.stat().st_size for path in paths)
    entries, done_bytes = [], 0
    for path in sorted(paths):
        size_bytes = path.stat().st_size
        relative = path.relative_to(folder).as_posix()
        entries.append(FileEntry(path=relative, size_bytes=size_bytes, sha256=file_sha256(path)))
        done_bytes += size_bytes
        progress("hash", done_bytes, total_bytes)
    return tuple(entries)


def _files(folder: Path, root: Path, above: tuple[Path, ...]) -> Iterator[Path]:
    """Yield the files below `folder`, following links inside of `root`; `above` are folders on the way."""
    above = (*above, folder.resolve())
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        if path.is_symlink() and not _leads_inside(path, root):
            raise UsageProblemError(
                "scene.link",
                f"{path} is a symbolic link that leads nowhere or out of the folder",
                "copy the file itself there",
            )
        if not path.is_dir():
            yield path
        elif path.resolve() not in above:  # a link in a circle adds nothing
            yield from _files(path, root, above)


def _leads_inside(path: Path, root: Path) -> bool:
    try:
        return path.resolve(strict=True).is_relative_to(root)
    except (OSError, RuntimeError):  # nowhere, or in a circle
        return False


def content_sha256(entries: tuple[FileEntry, ...]) -> str:
    """Return one hash of a whole scene: equal exactly when every path and every byte is equal."""
    lines = "".join(f"{entry.sha256}  {entry.path}\n" for entry in sorted(entries, key=lambda e: e.path))
    return hashlib.sha256(lines.encode()).hexdigest()


def push(
    connection: Connection,
    source: Path,
    *,
    name: str = "",
    progress: TransferProgress = ignore_progress,
) -> Scene:
    """Upload a scene folder or archive and return the committed scene.

    Bytes that the server has from an earlier push, even a broken one, are not sent again. `progress` hears of
    "hash" and "upload".
    """
    if source.is_file():
        return _push_archive(connection, source, name=name, progress=progress)
    entries = list_files(source, progress)
    scene = _create(connection, name or source.resolve().name)
    files = [{"path": e.path, "size": e.size_bytes, "sha256": e.sha256} for e in entries]

    def declare() -> Any:
        return connection.json("POST", f"/v1/scenes/{scene.id}/files:plan", json=files, repeatable=True)

    plan = patiently(connection, declare, is_store_away)
    _send_missing(connection, scene.id, source, entries, plan, progress)
    committed = Scene.from_json(connection.json("POST", f"/v1/scenes/{scene.id}:commit", repeatable=True))
    return replace(committed, left_out=tuple(plan.get("unsupported") or ()))


def _create(connection: Connection, name: str) -> Scene:
    return Scene.from_json(connection.json("POST", "/v1/scenes", json={"name": name[:100]}))


def _send_missing(
    connection: Connection,
    scene_id: str,
    folder: Path,
    entries: tuple[FileEntry, ...],
    plan: Mapping[str, Any],
    progress: TransferProgress,
) -> None:
    missing = set(plan["missing"])
    # Two files with the same bytes are one upload.
    unique = {entry.sha256: entry for entry in entries if entry.sha256 in missing}
    total_bytes = sum(entry.size_bytes for entry in unique.values())
    done_bytes = 0
    files = [
        LocalFile(path=folder / entry.path, sha256=entry.sha256, size_bytes=entry.size_bytes)
        for entry in unique.values()
    ]
    if plan.get("uploads"):

        def add(sent_bytes: int) -> None:
            nonlocal done_bytes
            done_bytes += sent_bytes
            progress("upload", min(done_bytes, total_bytes), total_bytes)

        with suppress(NoWayError):
            files = DirectSender(connection, scene_id, add).send(files, plan["uploads"])
    for file in files:

        def advance(sent_bytes: int, before: int = done_bytes) -> None:
            progress("upload", before + sent_bytes, total_bytes)

        def put(file: LocalFile = file, advance: Callable[[int], None] = advance) -> None:
            path = f"/v1/scenes/{scene_id}/files/{file.sha256}"
            connection.upload("PUT", path, file.path, advance=advance)

        patiently(connection, put) if plan.get("uploads") else put()
        done_bytes += file.size_bytes
    progress("upload", total_bytes, total_bytes)


def _push_archive(connection: Connection, source: Path, *, name: str, progress: TransferProgress) -> Scene:
    media_type = next((kind for end, kind in ARCHIVES.items() if source.name.lower().endswith(end)), "")
    if not media_type:
        raise UsageProblemError(
            "scene.unknown_archive",
            f"{source.name} is not an archive this client sends",
            f"give a folder, or a file that ends in {', '.join(ARCHIVES)}",
        )
    scene = _create(connection, name or source.name.split(".")[0])
    size_bytes = source.stat().st_size

    try:
        answer = connection.upload(
            "PUT",
            f"/v1/scenes/{scene.id}/archive",
            source,
            media_type=media_type,
            advance=lambda sent_bytes: progress("upload", sent_bytes, size_bytes),
        )
    except RefusedError as error:
        # The first try got through and only its answer was lost.
        if error.code != "scene_committed":
            raise
        answer = connection.json("GET", f"/v1/scenes/{scene.id}")
    return Scene.from_json(answer)
