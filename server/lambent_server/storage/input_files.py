"""Input files of a run, and their paths in its folder."""

from lambent_proto.v1 import worker_pb2
from sqlalchemy import Connection

from lambent_server.database.model import ArtifactRow, BundleFileRow, EnvironmentRow, SceneFileRow
from lambent_server.database.rows import Kind, many, table_of
from lambent_server.database.tenancy import Tenant, find, rows

Files = list[worker_pb2.SceneFile]


def input_file(
    path: str, row: SceneFileRow | BundleFileRow | EnvironmentRow | ArtifactRow
) -> worker_pb2.SceneFile:
    """Return the file of a row as `path`."""
    return worker_pb2.SceneFile(path=path, sha256=row.sha256, size_bytes=row.size_bytes)


def scene_inputs(connection: Connection, tenant: Tenant, scene_id: str) -> Files:
    """Return the files of a scene under their own paths."""
    files = _sorted(connection, tenant, SceneFileRow, scene_id=scene_id)
    return [input_file(row.path, row) for row in files]


def bundle_inputs(connection: Connection, tenant: Tenant, bundle_id: str, folder: str) -> Files:
    """Return the files of a bundle as `<folder>/...`; none if it was deleted."""
    files = _sorted(connection, tenant, BundleFileRow, bundle_id=bundle_id)
    return [input_file(f"{folder}/{row.path}", row) for row in files]


def environment_input(connection: Connection, tenant: Tenant, environment_id: str, stem: str) -> Files:
    """Return the file of an environment as `<stem>.<format>`; none if it was deleted."""
    row = find(connection, tenant, EnvironmentRow, environment_id)
    return [] if row is None else [input_file(f"{stem}.{row.format}", row)]


def _sorted(connection: Connection, tenant: Tenant, kind: type[Kind], **having: str) -> list[Kind]:
    table = table_of(kind)
    return many(connection, rows(tenant, table).filter_by(**having).order_by(table.c.path), kind)
