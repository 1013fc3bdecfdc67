"""Database rows of bundles: lists of bundles, and the files of one."""

from typing import Any

from sqlalchemy import Connection, func

from lambent_server.bundle_messages import Bundle, BundleDetail, BundleFile
from lambent_server.clock import rfc3339
from lambent_server.database.schema import bundle_files, bundles, scenes
from lambent_server.database.tenancy import Tenant, find, rows
from lambent_server.problems import not_found


def require_bundle(connection: Connection, tenant: Tenant, bundle_id: str) -> dict[str, Any]:
    """Return the bundle's row."""
    row = find(connection, tenant, bundles, bundle_id)
    if row is None:
        raise not_found("bundle", bundle_id)
    return dict(row)


def show(connection: Connection, tenant: Tenant, row: Any) -> Bundle:
    """Return a bundle in the form of the REST interface."""
    scene = find(connection, tenant, scenes, row["scene_id"])
    sums = rows(tenant, bundle_files, func.count(), func.sum(bundle_files.c.size_bytes))
    count, size = connection.execute(sums.where(bundle_files.c.bundle_id == row["id"])).one()
    return Bundle(
        id=row["id"],
        job_id=row["job_id"],
        scene_id=row["scene_id"],
        scene_name="" if scene is None else scene["name"],
        created_at=rfc3339(row["created_at"]),
        num_files=count,
        size_bytes=size or 0.0,
    )


def show_files(connection: Connection, tenant: Tenant, row: Any) -> BundleDetail:
    """Return a bundle with its files, sorted by path."""
    statement = rows(tenant, bundle_files).where(bundle_files.c.bundle_id == row["id"])
    found = connection.execute(statement.order_by(bundle_files.c.path)).mappings()
    files = [
        BundleFile(
            **{name: each[name] for name in ("path", "sha256", "size_bytes", "media_type")},
            url=f"/v1/bundles/{row['id']}/files/{each['path']}",
        )
        for each in found
    ]
    return BundleDetail(**show(connection, tenant, row).model_dump(), files=files)
