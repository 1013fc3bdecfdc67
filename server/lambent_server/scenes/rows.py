"""Database rows of scenes: planning files, committing, rejecting, deleting."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, insert

from lambent_server.api import idempotency
from lambent_server.api import labels as label_rows
from lambent_server.api.change_messages import SceneChange
from lambent_server.api.messages import NewScene, Scene
from lambent_server.api.problems import Detail, Problem, conflict
from lambent_server.api.resources import require
from lambent_server.core.clock import new_id, now
from lambent_server.core.settings import Settings
from lambent_server.database.model import SceneFileRow, SceneRow
from lambent_server.database.rows import many
from lambent_server.database.schema import blobs, jobs, scene_files, scenes
from lambent_server.database.tenancy import Tenant, add, change, remove, rows
from lambent_server.jobs.checkpoints import drop_checkpoints_of_scene
from lambent_server.jobs.rows import is_unfinished
from lambent_server.scenes.figures import forget_figures
from lambent_server.storage.paths import Names, check_path, clash_with, is_scene_file
from lambent_server.storage.store import blob_url, discard, touch


@dataclass(frozen=True, slots=True)
class SceneFile:
    """A planned file of a scene."""

    path: str
    sha256: str
    size_bytes: int


def require_scene(connection: Connection, tenant: Tenant, scene_id: str, *, lock: bool = False) -> SceneRow:
    """Return the scene's row."""
    return require(connection, tenant, SceneRow, "scene", scene_id, lock=lock)


def require_open(row: SceneRow) -> None:
    """Refuse to change the files of a scene that has been committed."""
    if row.state != "open":
        raise conflict("scene_committed", f"scene {row.id} is {row.state}: its files can no longer change")


def show(row: SceneRow) -> Scene:
    """Return the scene in the form of the REST interface."""
    return Scene.of(row, thumbnail_url=blob_url(row.thumbnail_sha256), labels=row.labels or {})


def set_thumbnail(connection: Connection, tenant: Tenant, scene: SceneRow, sha256: str) -> None:
    """Replace the photograph of the scene; an empty hash keeps the one it has."""
    if not sha256 or sha256 == scene.thumbnail_sha256:
        return
    if touch(connection, tenant, sha256) is None:
        raise Problem(422, "blob_missing", f"thumbnail: blob {sha256} was never uploaded")
    if scene.thumbnail_sha256:
        discard(connection, tenant, scene.thumbnail_sha256)
    update = change(tenant, scenes).where(scenes.c.id == scene.id)
    connection.execute(update.values(thumbnail_sha256=sha256))


def create(
    connection: Connection, tenant: Tenant, order: NewScene, key: str | None = None, digest: str = ""
) -> SceneRow:
    """Add an empty scene, or return the one that was added earlier with this idempotency key."""
    identifier = new_id("scene")
    known = idempotency.made_before(connection, tenant, key, digest, identifier)
    if known is not None:
        return require_scene(connection, tenant, known)
    values = {"name": order.name, "labels": order.labels, "state": "open", "created_at": now()}
    connection.execute(add(tenant, scenes, id=identifier, size_bytes=0.0, **values))
    label_rows.store(connection, tenant, identifier, order.labels)
    return require_scene(connection, tenant, identifier)


def change_scene(connection: Connection, tenant: Tenant, scene: SceneRow, order: SceneChange) -> SceneRow:
    """Change name or labels of a scene; the caller holds its row."""
    values: dict[str, Any] = {} if order.name is None else {"name": order.name}
    if order.labels is not None:
        values["labels"] = label_rows.merged(scene.labels, order.labels)
        label_rows.store(connection, tenant, scene.id, values["labels"])
    if values:
        connection.execute(change(tenant, scenes).where(scenes.c.id == scene.id).values(**values))
    return require_scene(connection, tenant, scene.id)


def check_files(files: Sequence[SceneFile], settings: Settings) -> None:
    """Refuse a list of files that cannot be a scene; the problem names each invalid one."""
    details: list[Detail] = []
    names = Names()
    paths: dict[str, str] = {}
    for place, file in enumerate(files):
        try:
            check_path(file.path, f"#/{place}/path")
        except Problem as problem:
            details.extend(problem.errors)
            continue
        if file.path in paths:
            if paths[file.path] != file.sha256:
                details.append(Detail(f"#/{place}/path", "is listed twice with different contents"))
            continue
        clash = names.add(file.path)
        if clash is not None:
            details.append(Detail(f"#/{place}/path", clash_with(clash)))
        paths[file.path] = file.sha256
    if details:
        raise Problem(422, "path_unsafe", f"{len(details)} path(s) cannot be used", errors=details[:100])
    total = sum(file.size_bytes for file in files)
    if len(files) > settings.max_scene_files:
        detail = f"a scene may have {settings.max_scene_files} files, this one has {len(files)}"
        raise Problem(413, "scene_too_many_files", detail)
    if total > settings.max_scene_bytes:
        detail = f"a scene may have {settings.max_scene_bytes} bytes, this one has {total}"
        raise Problem(413, "scene_too_large", detail)


def unsupported_report(paths: Sequence[str]) -> dict[str, Any]:
    """Return a report that lists the omitted files."""
    message = "this type of file does not belong in a scene; it was omitted"
    return unchecked_report(*(_finding("unsupported_file", "warning", message, path) for path in paths[:100]))


def _finding(code: str, severity: str, message: str, subject: str) -> dict[str, Any]:
    return {"code": code, "severity": severity, "message": message, "subject": subject}


def unchecked_report(*findings: dict[str, Any]) -> dict[str, Any]:
    """Return the report of a scene that no job has checked."""
    return {
        "usable": False,
        "layout": "",
        "findings": list(findings),
        "num_train_frames": 0,
        "num_test_frames": 0,
    }


@dataclass(frozen=True, kw_only=True, slots=True)
class FilePlan:
    """The files of a plan by what the client has to do with them."""

    missing: list[str]
    """Hashes the server does not know."""
    known: dict[str, int]
    """Hashes it knows, with their sizes."""
    unsupported: list[str]
    """Paths that are omitted."""


def plan(connection: Connection, tenant: Tenant, scene: SceneRow, files: Sequence[SceneFile]) -> FilePlan:
    """Replace the planned files of the scene with `files`."""
    require_open(scene)
    _forget_files(connection, tenant, scene.id)
    kept = {file.path: file for file in files if is_scene_file(file.path)}
    unsupported = sorted({file.path for file in files} - set(kept))
    if kept:
        values = [
            {
                "tenant_id": tenant.id,
                "scene_id": scene.id,
                "path": file.path,
                "sha256": file.sha256,
                "size_bytes": float(file.size_bytes),
            }
            for file in kept.values()
        ]
        connection.execute(insert(scene_files), values)
    update = change(tenant, scenes).where(scenes.c.id == scene.id)
    connection.execute(update.values(report=unsupported_report(unsupported) if unsupported else None))
    # In one order, so that two plans never wait for each other.
    hashes = sorted({file.sha256 for file in kept.values()})
    sizes = {sha256: touch(connection, tenant, sha256) for sha256 in hashes}
    return FilePlan(
        missing=[sha256 for sha256, size in sizes.items() if size is None],
        known={sha256: size for sha256, size in sizes.items() if size is not None},
        unsupported=unsupported,
    )


def _forget_files(connection: Connection, tenant: Tenant, scene_id: str) -> None:
    mine = scene_files.c.scene_id == scene_id
    for sha256 in set(
        connection.execute(rows(tenant, scene_files, scene_files.c.sha256).where(mine)).scalars()
    ):
        discard(connection, tenant, sha256)
    connection.execute(remove(tenant, scene_files).where(mine))


def commit(connection: Connection, tenant: Tenant, scene: SceneRow) -> SceneRow:
    """Finish the upload; every planned file must exist. Repeating it changes nothing."""
    if scene.state != "open":
        return scene
    mine = scene_files.c.scene_id == scene.id
    files = many(connection, rows(tenant, scene_files).where(mine).order_by(scene_files.c.path), SceneFileRow)
    if not files:
        raise conflict("scene_empty", "no file is planned; send the list to files:plan, or an archive")
    held = rows(tenant, blobs, blobs.c.sha256).where(blobs.c.sha256.in_({file.sha256 for file in files}))
    have = set(connection.execute(held).scalars())
    missing = [file for file in files if file.sha256 not in have]
    if missing:
        errors = tuple(
            Detail(f"#/files/{file.path}", f"{file.sha256} was not sent") for file in missing[:100]
        )
        raise Problem(409, "files_missing", f"{len(missing)} file(s) were not sent yet", errors=errors)
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.path}\0{file.sha256}\n".encode())
    connection.execute(
        change(tenant, scenes)
        .where(scenes.c.id == scene.id)
        .values(
            state="uploaded",
            committed_at=now(),
            content_sha256=digest.hexdigest(),
            num_files=len(files),
            size_bytes=sum(file.size_bytes for file in files),
        )
    )
    return require_scene(connection, tenant, scene.id)


def reject(
    connection: Connection, tenant: Tenant, scene: SceneRow, code: str, message: str, subject: str
) -> None:
    """Mark the scene as unusable, with the reason."""
    report = unchecked_report(_finding(code, "error", message, subject))
    _forget_files(connection, tenant, scene.id)
    update = change(tenant, scenes).where(scenes.c.id == scene.id)
    connection.execute(update.values(state="rejected", report=report, committed_at=now()))


def delete(connection: Connection, tenant: Tenant, scene: SceneRow) -> None:
    """Delete the scene and its files; bundles made from it stay."""
    busy = rows(tenant, jobs, jobs.c.id).where(jobs.c.scene_id == scene.id, is_unfinished())
    job_id = connection.execute(busy.limit(1)).scalar_one_or_none()
    if job_id is not None:
        raise conflict("scene_in_use", f"job {job_id} uses this scene; cancel it first")
    _forget_files(connection, tenant, scene.id)
    if scene.thumbnail_sha256:
        discard(connection, tenant, scene.thumbnail_sha256)
    forget_figures(connection, tenant, scene.id)
    drop_checkpoints_of_scene(connection, tenant, scene.id)
    label_rows.forget(connection, tenant, scene.id)
    idempotency.forget(connection, tenant, scene.id)
    connection.execute(remove(tenant, scenes).where(scenes.c.id == scene.id))
