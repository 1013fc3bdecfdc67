"""Database rows of bundles: lists of bundles, and the files of one."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, func

from lambent_server import label_rows
from lambent_server.bundle_messages import Bundle, BundleDetail, BundleFile
from lambent_server.bundle_pictures import file_url, thumbnail_urls
from lambent_server.change_messages import BundleChange
from lambent_server.clock import rfc3339
from lambent_server.database.schema import bundle_files, bundles, scenes
from lambent_server.database.tenancy import Tenant, change, find, rows
from lambent_server.problems import not_found


def require_bundle(
    connection: Connection, tenant: Tenant, bundle_id: str, *, lock: bool = False
) -> dict[str, Any]:
    """Return the bundle's row."""
    row = find(connection, tenant, bundles, bundle_id, lock=lock)
    if row is None:
        raise not_found("bundle", bundle_id)
    return dict(row)


def change_bundle(
    connection: Connection, tenant: Tenant, row: dict[str, Any], order: BundleChange
) -> dict[str, Any]:
    """Change the labels of a bundle; the caller holds its row."""
    if order.labels is not None:
        labels = label_rows.merged(row["labels"], order.labels)
        label_rows.store(connection, tenant, row["id"], labels)
        connection.execute(change(tenant, bundles).where(bundles.c.id == row["id"]).values(labels=labels))
    return require_bundle(connection, tenant, row["id"])


def show(connection: Connection, tenant: Tenant, row: Any) -> Bundle:
    """Return a bundle in the form of the REST interface."""
    return show_all(connection, tenant, [row])[0]


def show_all(connection: Connection, tenant: Tenant, found: Sequence[Any]) -> list[Bundle]:
    """Return bundles in the form of the REST interface."""
    identifiers = [row["id"] for row in found]
    mine = bundle_files.c.bundle_id.in_(identifiers)
    columns = (bundle_files.c.bundle_id, func.count(), func.sum(bundle_files.c.size_bytes))
    sums = rows(tenant, bundle_files, *columns).where(mine).group_by(bundle_files.c.bundle_id)
    sizes = {bundle_id: (count, size) for bundle_id, count, size in connection.execute(sums)}
    scene_ids = {row["scene_id"] for row in found}
    named = rows(tenant, scenes, scenes.c.id, scenes.c.name).where(scenes.c.id.in_(scene_ids))
    names = dict(iter(connection.execute(named)))
    shown = thumbnail_urls(connection, tenant, identifiers)
    return [
        Bundle(
            id=row["id"],
            job_id=row["job_id"],
            scene_id=row["scene_id"],
            scene_name=names.get(row["scene_id"], ""),
            created_at=rfc3339(row["created_at"]),
            num_files=sizes.get(row["id"], (0, 0.0))[0],
            size_bytes=sizes.get(row["id"], (0, 0.0))[1],
            thumbnail_url=shown.get(row["id"]),
            labels=row["labels"] or {},
        )
        for row in found
    ]





def show_files(connection: Connection, tenant: Tenant, row: Any) -> BundleDetail:
    """Return a bundle with its files, sorted by path."""
    statement = rows(tenant, bundle_files).where(bundle_files.c.bundle_id == row["id"])
    found = connection.execute(statement.order_by(bundle_files.c.path)).mappings()
    files = [
        BundleFile(
            **{name: each[name] for name in ("path", "sha256", "size_bytes", "media_type")},
            url=file_url(row["id"], each["path"]),
        )
        for each in found
    ]
    return BundleDetail(**show(connection, tenant, row).model_dump(), files=files)
