"""The page of a share link: shown by itself, or in frames of the origins that the link names."""

from html import escape

import lambent_pages
from fastapi import APIRouter, Request, Response
from sqlalchemy import Connection
from starlette.exceptions import HTTPException

from lambent_server.accounts import shares
from lambent_server.bundles.rows import require_bundle, show
from lambent_server.database.model import ShareRow
from lambent_server.database.tenancy import Tenant
from lambent_server.http.blob_responses import Asked, send_blob
from lambent_server.http.common import Id, ServicesOf
from lambent_server.storage.bundle_pictures import LARGE_FIRST, pictures
from lambent_server.storage.store import Blob

router = APIRouter(include_in_schema=False)

_MEDIA_TYPES = {"webp": "image/webp", "png": "image/png"}
_PICTURE_SECONDS = 600


@router.get("/embed/{share_id:id}", response_class=Response)
def get_embed_page(services: ServicesOf, share_id: Id, request: Request) -> Response:
    """Return the page of a link, with the name and the picture of its object for those who preview links.

    The secret is in the fragment, which no server sees: this page alone opens no bundle. It has status 410
    for at least 30 days after the end of the link, and 404 later.
    """
    with services.database.read() as connection:
        row = shares.find_any(connection, share_id)
        if row is None:
            unknown = lambent_pages.not_found()
            return Response(unknown.content, status_code=404, headers=unknown.headers)
        active = shares.is_active(row)
        head = _head(connection, row, str(request.base_url).rstrip("/")) if active else ""
    page = lambent_pages.embed_page(head, shares.frame_ancestors(row))
    if page is None:
        absent = lambent_pages.not_built()
        return Response(absent.content, status_code=503, headers=absent.headers)
    return Response(page.content, status_code=200 if active else 410, headers=page.headers)


@router.get("/embed/{share_id:id}/picture", response_class=Response)
def get_embed_picture(services: ServicesOf, share_id: Id) -> Response:
    """Return the picture of a link's object, for previews of the link and as poster of its viewer."""
    with services.database.read() as connection:
        row = shares.find_any(connection, share_id)
        # An id alone shows as much as the previews of its link.
        blob = _picture(connection, row) if row is not None and shares.is_active(row) else None
    if blob is None:
        raise HTTPException(404)
    response = send_blob(services, blob, Asked())
    # A link may be revoked, and its picture may be shown by pages that isolate themselves.
    response.headers["cache-control"] = f"public, max-age={_PICTURE_SECONDS}"
    response.headers["cross-origin-resource-policy"] = "cross-origin"
    return response


def _head(connection: Connection, row: ShareRow, base: str) -> str:
    """Return the elements of the head that name the object; every text in them is escaped."""
    tenant = Tenant(row.tenant_id)
    bundle = show(connection, tenant, require_bundle(connection, tenant, row.bundle_id))
    title = bundle.scene_name or "A relightable object"
    named = {
        "og:type": "website",
        "og:site_name": "Lambent",
        "og:title": title,
        "og:description": "Turn it, and choose its light.",
        "twitter:card": "summary",
    }
    if _picture(connection, row) is not None:
        named["og:image"] = f"{base}{shares.page_path(row.id)}/picture"
        named["og:image:alt"] = title
        named["twitter:card"] = "summary_large_image"
    lines = [f'<meta name="lambent-bundle" content="{escape(row.bundle_id)}" />']
    lines += [f'<meta property="{name}" content="{escape(text)}" />' for name, text in named.items()]
    return "\n    ".join([f"<title>{escape(title)}</title>", *lines])


def _picture(connection: Connection, row: ShareRow) -> Blob | None:
    """Return the picture of a link's bundle, or None."""
    bundle_id = row.bundle_id
    picture = pictures(connection, Tenant(row.tenant_id), [bundle_id], LARGE_FIRST).get(bundle_id)
    if picture is None:
        return None
    # By the path: the media type that a run has given is not trusted.
    media_type = _MEDIA_TYPES[picture.path.rpartition(".")[2]]
    return Blob(picture.sha256, int(picture.size_bytes), media_type)
