"""Database rows of bundles: lists of bundles, and the files of one."""

from collections.abc import Sequence

from sqlalchemy import Connection, func

from lambent_server.api import labels as label_rows
from lambent_server.api.change_messages import BundleChange
from lambent_server.api.resources import require
from lambent_server.bundles.messages import Bundle, BundleDetail, BundleFile
from lambent_server.database.model import BundleFileRow, BundleRow
from lambent_server.database.rows import many
from lambent_server.database.schema import bundle_files, bundles, scenes
from lambent_server.database.tenancy import Tenant, change, rows
from lambent_server.storage.bundle_pictures import file_url, thumbnail_urls


def require_bundle(
    connection: Connection, tenant: Tenant, bundle_id: str, *, lock: bool = False
) -> BundleRow:
    """Return the bundle's row."""
    return require(connection, tenant, BundleRow, "bundle", bundle_id, lock=lock)


def change_bundle(connection: Connection, tenant: Tenant, row: BundleRow, order: BundleChange) -> BundleRow:
    """Change the labels of a bundle; the caller holds its row."""
    if order.labels is not None:
        labels = label_rows.merged(row.labels, order.labels)
        label_rows.store(connection, tenant, row.id, labels)
        connection.execute(change(tenant, bundles).where(bundles.c.id == row.id).values(labels=labels))
    return require_bundle(connection, tenant, row.id)


def show(connection: Connection, tenant: Tenant, row: BundleRow) -> Bundle:
    """Return a bundle in the form of the REST interface."""
    return show_all(connection, tenant, [row])[0]


def show_all(connection: Connection, tenant: Tenant, bundle_rows: Sequence[BundleRow]) -> list[Bundle]:
    """Return bundles in the form of the REST interface."""
    identifiers = [row.id for row in bundle_rows]
    mine = bundle_files.c.bundle_id.in_(identifiers)
    columns = (bundle_files.c.bundle_id, func.count(), func.sum(bundle_files.c.size_bytes))
    sums = rows(tenant, bundle_files, *columns).where(mine).group_by(bundle_files.c.bundle_id)
    sizes = {bundle_id: (count, size) for bundle_id, count, size in connection.execute(sums)}
    scene_ids = {row.scene_id for row in bundle_rows}
    named = rows(tenant, scenes, scenes.c.id, scenes.c.name).where(scenes.c.id.in_(scene_ids))
    names = {scene.id: scene.name for scene in connection.execute(named)}
    shown = thumbnail_urls(connection, tenant, identifiers)
    return [
        Bundle.of(
            row,
            scene_name=names.get(row.scene_id, ""),
            num_files=sizes.get(row.id, (0, 0.0))[0],
            size_bytes=sizes.get(row.id, (0, 0.0))[1],
            thumbnail_url=shown.get(row.id),
            labels=row.labels or {},
        )
        for row in bundle_rows
    ]


def show_files(connection: Connection, tenant: Tenant, row: BundleRow) -> BundleDetail:
    """Return a bundle with its files, sorted by path."""
    statement = rows(tenant, bundle_files).where(bundle_files.c.bundle_id == row.id)
    files = [
        BundleFile.of(each, url=file_url(row.id, each.path))
        for each in many(connection, statement.order_by(bundle_files.c.path), BundleFileRow)
    ]
    return BundleDetail(**show(connection, tenant, row).model_dump(), files=files)
