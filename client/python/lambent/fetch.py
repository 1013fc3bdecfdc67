"""Downloading a bundle: resumable, verified against the manifest, and visible only when it is whole."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from lambent_core.files import file_sha256

from lambent.connection import Connection, TransferProgress, ignore_progress
from lambent.errors import DigestMismatchError, RefusedError, UsageProblemError
from lambent.models import Artifact, FileEntry
from lambent.provenance import beside

PIECE_BYTES = 1 << 18


@dataclass(frozen=True, kw_only=True, slots=True)
class FetchedBundle:
    """A complete, verified bundle folder."""

    bundle_id: str
    path: Path
    files: tuple[FileEntry, ...]

    def __repr__(self) -> str:
        """Return id, folder and number of files in one line."""
        return f"FetchedBundle({self.bundle_id!r}, {str(self.path)!r}, {len(self.files)} files)"


def fetch(
    connection: Connection,
    bundle_id: str,
    target: Path,
    *,
    progress: TransferProgress = ignore_progress,
) -> FetchedBundle:
    """Download a bundle into the folder `target`, which appears only once every file is verified.

    `progress` is called with the path of a file, the bytes of the whole bundle that are done, and its size.
    What an interrupted fetch left in `target.partial` is used. An existing `target` with the same
    bundle is verified and kept; one with anything else is refused (`fetch.target_in_use`). Raises
    `fetch.digest_mismatch` when bytes differ from the manifest twice in a row.
    """
    manifest = connection.send("GET", f"/v1/bundles/{bundle_id}/manifest").content
    entries = _entries(manifest)
    total_bytes = sum(entry.size_bytes for entry in entries)
    if target.exists() and not (target.is_dir() and not any(target.iterdir())):
        if _is_complete(target, manifest, entries):
            progress("", total_bytes, total_bytes)
            return FetchedBundle(bundle_id=bundle_id, path=target, files=entries)
        raise UsageProblemError(
            "fetch.target_in_use",
            f"{target} exists and is not a complete copy of bundle {bundle_id}",
            "choose another folder, or remove that one",
        )
    partial = target.with_name(target.name + ".partial")
    partial.mkdir(parents=True, exist_ok=True)
    done_bytes = 0
    for entry in entries:

        def advance(file_bytes: int, before: int = done_bytes, path: str = entry.path) -> None:
            progress(path, before + file_bytes, total_bytes)

        url = f"/v1/bundles/{bundle_id}/files/{entry.path}"
        _fetch_file(connection, url, entry, partial / entry.path, advance)
        done_bytes += entry.size_bytes
    (partial / "manifest.json").write_bytes(manifest)
    _remove_strangers(partial, entries)
    if target.exists():
        target.rmdir()
    os.replace(partial, target)
    return FetchedBundle(bundle_id=bundle_id, path=target, files=entries)


def fetch_statement(connection: Connection, bundle_id: str, target: Path) -> Path | None:
    """Write the signed statement of a bundle beside the folder `target` and return its path.

    None if the bundle has none; that of another bundle at the same place is removed, because it would accuse
    this one of having been changed.
    """
    try:
        statement = connection.send("GET", f"/v1/bundles/{bundle_id}/provenance").content
    except RefusedError as error:
        if error.status != 404:
            raise
        beside(target).unlink(missing_ok=True)
        return None
    path = beside(target)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(statement)
    os.replace(partial, path)
    return path


def peek(connection: Connection, bundle_id: str, target: Path) -> Path:
    """Write manifest.json and cameras.json of a bundle into the folder `target` and return it.

    That is enough to say what can be seen of it. Raises `fetch.digest_mismatch` as `fetch` does.
    """
    manifest = connection.send("GET", f"/v1/bundles/{bundle_id}/manifest").content
    target.mkdir(parents=True, exist_ok=True)
    (target / "manifest.json").write_bytes(manifest)
    for entry in _entries(manifest):
        if entry.path == "cameras.json":
            url = f"/v1/bundles/{bundle_id}/files/{entry.path}"
            _fetch_file(connection, url, entry, target / entry.path, lambda done: None)
    return target


def download(connection: Connection, artifact: Artifact, target: Path) -> Path:
    """Write an artifact to `target` and return it: verified, whole, resumed, and kept if it exists.

    Raises `fetch.digest_mismatch` when bytes differ from what was announced twice in a row.
    """
    entry = FileEntry(path=artifact.name, size_bytes=int(artifact.size_bytes), sha256=artifact.sha256)
    if not _matches(target, entry):
        partial = target.with_name(f".partial-{target.name}")
        _fetch_file(connection, f"/v1/blobs/{artifact.sha256}", entry, partial, lambda done: None)
        os.replace(partial, target)
    return target


def download_all(connection: Connection, artifacts: Iterable[Artifact], target: Path) -> list[Path]:
    """Write artifacts under their names into the folder `target` and return their paths.

    As `download` does, each of them; raises `fetch.unsafe_path` for a name that leads out of the folder.
    """
    paths = [(artifact, target / _path_inside(artifact.name)) for artifact in artifacts]
    for _, path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
    return [download(connection, artifact, path) for artifact, path in paths]


def check_digest(name: str, content: bytes, sha256: str) -> None:
    """Raise `fetch.digest_mismatch` unless `content` has the hash it was announced with."""
    if hashlib.sha256(content).hexdigest() != sha256:
        raise DigestMismatchError(
            "fetch.digest_mismatch",
            f"{name} arrived with other bytes than were announced",
            "check any proxy between the machines, then fetch again",
        )


def _entries(manifest: bytes) -> tuple[FileEntry, ...]:
    return tuple(
        FileEntry(
            path=_path_inside(item["path"]), size_bytes=int(item["size_bytes"]), sha256=item["sha256"].lower()
        )
        for item in json.loads(manifest)["files"]
    )


def _path_inside(name: str) -> str:
    """Return a path that came from elsewhere; raises `fetch.unsafe_path` where it leaves the folder."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or not path.parts:
        raise UsageProblemError(
            "fetch.unsafe_path",
            f"the server names the file {name!r}",
            "do not use it: it would be written outside its folder",
        )
    return str(path)


def _is_complete(folder: Path, manifest: bytes, entries: tuple[FileEntry, ...]) -> bool:
    stored = folder / "manifest.json"
    return (
        stored.is_file()
        and json.loads(stored.read_bytes()) == json.loads(manifest)
        and all(_matches(folder / entry.path, entry) for entry in entries)
    )


def _matches(path: Path, entry: FileEntry) -> bool:
    whole = path.is_file() and path.stat().st_size == entry.size_bytes
    return whole and file_sha256(path) == entry.sha256


def _fetch_file(
    connection: Connection, url: str, entry: FileEntry, path: Path, advance: Callable[[int], None]
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    for _ in range(2):
        if _matches(path, entry):
            advance(entry.size_bytes)
            return
        if path.is_file() and path.stat().st_size >= entry.size_bytes:
            path.unlink()  # as long as announced, and still wrong: start again
        _download(connection, url, path, entry, advance)
    if not _matches(path, entry):
        path.unlink(missing_ok=True)
        raise DigestMismatchError(
            "fetch.digest_mismatch",
            f"{entry.path} arrived twice with bytes that do not match the manifest",
            "check the disk of both machines and any proxy between them, then fetch again",
        )


def _download(
    connection: Connection, url: str, path: Path, entry: FileEntry, advance: Callable[[int], None]
) -> None:
    have = path.stat().st_size if path.is_file() else 0
    headers = {"Range": f"bytes={have}-", "If-Range": f'"{entry.sha256}"'} if have else {}
    try:
        with connection.stream(url, headers=headers, timeout_s=60.0) as response:
            resumes = have > 0 and response.status_code == 206
            done = have if resumes else 0
            with path.open("ab" if resumes else "wb") as file:
                for piece in response.iter_bytes(PIECE_BYTES):
                    file.write(piece)
                    done += len(piece)
                    advance(done)
                file.flush()
                os.fsync(file.fileno())
    except RefusedError as error:
        if error.status != 416:
            raise
        path.unlink(missing_ok=True)


def _remove_strangers(folder: Path, entries: tuple[FileEntry, ...]) -> None:
    """Drop what an earlier fetch of another bundle left in the partial folder."""
    wanted = {"manifest.json", *(entry.path for entry in entries)}
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_file() and path.relative_to(folder).as_posix() not in wanted:
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            shutil.rmtree(path)
