"""The picture that stands for a bundle: on the cards of jobs and bundles, and in previews of links."""

from collections.abc import Sequence
from urllib.parse import quote

from sqlalchemy import Connection

from lambent_server.database.model import BundleFileRow
from lambent_server.database.rows import many
from lambent_server.database.schema import bundle_files
from lambent_server.database.tenancy import Tenant, rows

SMALL_FIRST = ("thumbnail.webp", "poster.webp")
"""Pictures that were made to stand for the object, for a card in a list."""
LARGE_FIRST = SMALL_FIRST[::-1]
"""The same for a page that shows the object alone."""


def thumbnail_urls(connection: Connection, tenant: Tenant, identifiers: Sequence[str]) -> dict[str, str]:
    """Return the address of the picture for a card of each bundle that has one."""
    files = pictures(connection, tenant, identifiers, SMALL_FIRST)
    return {bundle_id: file_url(bundle_id, file.path) for bundle_id, file in files.items()}


def pictures(
    connection: Connection, tenant: Tenant, identifiers: Sequence[str], posters: tuple[str, ...]
) -> dict[str, BundleFileRow]:
    """Return the file that stands for each bundle that has one: path, hash and size.

    That is the first of `posters`, or the first rendering of a view in bundles without any, which have no
    baked transport.
    """
    path = bundle_files.c.path
    renderings = (path.like("preview/%.png")) & (path.not_like("preview/photo\\_%", escape="\\"))
    statement = rows(tenant, bundle_files).where(
        bundle_files.c.bundle_id.in_(identifiers), path.in_(posters) | renderings
    )

    def rank(file: BundleFileRow) -> tuple[int, str]:
        return posters.index(file.path) if file.path in posters else len(posters), file.path

    chosen: dict[str, BundleFileRow] = {}
    for file in sorted(many(connection, statement, BundleFileRow), key=rank):
        chosen.setdefault(file.bundle_id, file)
    return chosen


def file_url(bundle_id: str, path: str) -> str:
    return f"/v1/bundles/{bundle_id}/files/{quote(path)}"
