"""Measurements of a scene, and their page: stored with the scene and replaced by the next check."""

import json

from lambent_proto.v1 import capture_pb2
from sqlalchemy import Connection

from lambent_server.api.problems import Problem
from lambent_server.api.rest_json import to_rest
from lambent_server.database.model import FiguresRow
from lambent_server.database.rows import one
from lambent_server.database.schema import scene_figures
from lambent_server.database.tenancy import Tenant, add, remove, rows
from lambent_server.storage.store import discard, touch


def find_figures(connection: Connection, tenant: Tenant, scene_id: str) -> FiguresRow | None:
    """Return the row of a scene's figures, or None if nothing was measured."""
    statement = rows(tenant, scene_figures).where(scene_figures.c.scene_id == scene_id)
    return one(connection, statement, FiguresRow)


def forget_figures(connection: Connection, tenant: Tenant, scene_id: str) -> None:
    """Delete a scene's figures, and release the page."""
    row = find_figures(connection, tenant, scene_id)
    if row is None:
        return
    if row.sha256:
        discard(connection, tenant, row.sha256)
    connection.execute(remove(tenant, scene_figures).where(scene_figures.c.scene_id == scene_id))


def store_figures(
    connection: Connection,
    tenant: Tenant,
    scene_id: str,
    figures: capture_pb2.CaptureFigures | None,
    page_sha256: str,
) -> None:
    """Replace the figures of a scene; `page_sha256` names a blob, or is empty without a page."""
    forget_figures(connection, tenant, scene_id)
    if figures is None:
        return
    if page_sha256 and touch(connection, tenant, page_sha256) is None:
        raise Problem(422, "blob_missing", f"page: blob {page_sha256} was never uploaded")
    shown = to_rest(figures)
    try:
        json.dumps(shown, allow_nan=False)
    except ValueError as error:
        raise Problem(
            422, "figures_not_finite", "figures contain NaN or infinity, which JSON lacks"
        ) from error
    connection.execute(add(tenant, scene_figures, scene_id=scene_id, figures=shown, sha256=page_sha256))
