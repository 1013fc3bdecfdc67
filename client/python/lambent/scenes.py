"""Uploading a scene: plan, send what is missing, commit. Run again, it sends only what is still missing."""

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from lambent.connection import Connection
from lambent.errors import RefusedError, UsageProblemError
from lambent.models import FileEntry, Scene

UploadProgress = Callable[[str, int, int], None]
"""Called with (what is going on: "hash" or "upload", bytes done, bytes in all)."""

PIECE_BYTES = 1 << 20
ARCHIVE_SUFFIXES = (".zip", ".tar", ".tar.gz", ".tgz")


def ignore_progress(what: str, done_bytes: int, total_bytes: int) -> None:
    """Do nothing with upload progress."""


def list_files(folder: Path, progress: UploadProgress = ignore_progress) -> tuple[FileEntry, ...]:
    """Return every file of a scene folder, sorted by path, with sizes and hashes.

    Names that begin with a dot are left out. Symbolic links are refused (`scene.link`): what they
    point at may lie outside the folder.
    """
    if not folder.is_dir():
        raise UsageProblemError(
            "scene.not_a_folder", f"{folder} is not a folder or archive", "give the folder of one scene"
        )
    paths = []
    for root, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for name in [*folders, *names]:
            if (Path(root) / name).is_symlink():
                raise UsageProblemError(
                    "scene.link", f"{Path(root) / name} is a symbolic link", "copy the file itself there"
                )
        paths += [Path(root) / name for name in names if not name.startswith(".")]
    if not paths:
        raise UsageProblemError("scene.empty", f"{folder} holds no files", "give the folder of one scene")
    total_bytes = sum(path.stat().st_size for path in paths)
    entries, done_bytes = [], 0
    for path in sorted(paths):
        size_bytes = path.stat().st_size
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        relative = path.relative_to(folder).as_posix()
        entries.append(FileEntry(path=relative, size_bytes=size_bytes, sha256=digest))
        done_bytes += size_bytes
        progress("hash", done_bytes, total_bytes)
    return tuple(entries)


def content_sha256(entries: tuple[FileEntry, ...]) -> str:
    """Return one hash of a whole scene: equal exactly when every path and every byte is equal."""
    lines = "".join(f"{entry.sha256}  {entry.path}\n" for entry in sorted(entries, key=lambda e: e.path))
    return hashlib.sha256(lines.encode()).hexdigest()


def push(
    connection: Connection,
    source: Path,
    *,
    name: str = "",
    layout: str = "",
    progress: UploadProgress = ignore_progress,
) -> Scene:
    """Upload a scene folder or archive and return the committed scene.

    The same folder pushed again lands on the same scene and sends nothing twice.
    """
    if source.is_file():
        return _push_archive(connection, source, name=name, layout=layout, progress=progress)
    entries = list_files(source, progress)
    body = {"name": name or source.resolve().name, **({"layout": layout} if layout else {})}
    key = f"push-{hashlib.sha256((json.dumps(body) + content_sha256(entries)).encode()).hexdigest()[:40]}"
    scene = _create(connection, body, key)
    if scene.state not in {"", "open"}:
        return scene
    files = [{"path": e.path, "size": e.size_bytes, "sha256": e.sha256} for e in entries]
    plan = connection.json("POST", f"/v1/scenes/{scene.id}/files:plan", json=files, repeatable=True)
    missing = {_digest_of(item) for item in plan["missing"]}
    _send_missing(connection, scene.id, source, entries, missing, progress)
    return Scene.from_json(connection.json("POST", f"/v1/scenes/{scene.id}:commit", repeatable=True))


def _create(connection: Connection, body: dict[str, str], key: str) -> Scene:
    """Return the open or committed scene for this content; make a new one where the old was deleted."""
    created = Scene.from_json(
        connection.json("POST", "/v1/scenes", json=body, headers={"Idempotency-Key": key})
    )
    try:
        return Scene.from_json(connection.json("GET", f"/v1/scenes/{created.id}"))
    except RefusedError as error:
        if error.status != 404:
            raise
    return Scene.from_json(connection.json("POST", "/v1/scenes", json=body))


def _send_missing(
    connection: Connection,
    scene_id: str,
    folder: Path,
    entries: tuple[FileEntry, ...],
    missing: set[str],
    progress: UploadProgress,
) -> None:
    # Two files with the same bytes are one upload.
    unique = {entry.sha256: entry for entry in entries if entry.sha256 in missing}
    total_bytes = sum(entry.size_bytes for entry in unique.values())
    done_bytes = 0
    for entry in unique.values():
        path = folder / entry.path

        def pieces(path: Path = path, before: int = done_bytes) -> Iterator[bytes]:
            sent = before
            with path.open("rb") as file:
                while piece := file.read(PIECE_BYTES):
                    yield piece
                    sent += len(piece)
                    progress("upload", sent, total_bytes)

        connection.send(
            "PUT",
            f"/v1/scenes/{scene_id}/files/{entry.sha256}",
            make_content=pieces,
            headers={"Content-Length": str(entry.size_bytes), "Content-Type": "application/octet-stream"},
        )
        done_bytes += entry.size_bytes
    progress("upload", total_bytes, total_bytes)


def _digest_of(item: Any) -> str:
    return item["sha256"] if isinstance(item, dict) else str(item)


def _push_archive(
    connection: Connection, source: Path, *, name: str, layout: str, progress: UploadProgress
) -> Scene:
    if not source.name.lower().endswith(ARCHIVE_SUFFIXES):
        raise UsageProblemError(
            "scene.unknown_archive",
            f"{source.name} is not an archive this client sends",
            f"give a folder, or a file that ends in {', '.join(ARCHIVE_SUFFIXES)}",
        )
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    body = {"name": name or source.name.split(".")[0], **({"layout": layout} if layout else {})}
    key = f"push-{hashlib.sha256((json.dumps(body) + digest).encode()).hexdigest()[:40]}"
    scene = _create(connection, body, key)
    if scene.state not in {"", "open"}:
        return scene
    size_bytes = source.stat().st_size

    def pieces() -> Iterator[bytes]:
        sent = 0
        with source.open("rb") as file:
            while piece := file.read(PIECE_BYTES):
                yield piece
                sent += len(piece)
                progress("upload", sent, size_bytes)

    media_type = "application/zip" if source.suffix.lower() == ".zip" else "application/x-tar"
    connection.send(
        "PUT",
        f"/v1/scenes/{scene.id}/archive",
        make_content=pieces,
        headers={"Content-Length": str(size_bytes), "Content-Type": media_type},
    )
    return Scene.from_json(connection.json("POST", f"/v1/scenes/{scene.id}:commit", repeatable=True))
