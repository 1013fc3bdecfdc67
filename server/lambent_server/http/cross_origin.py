"""Reads of a shared bundle from pages of other origins: only those that its link names (CORS)."""

from starlette.datastructures import Headers

from lambent_server.accounts.shares import bundle_read, is_named_by_a_link
from lambent_server.database.engine import Database

_PREFLIGHT_S = 600


def preflight(method: str, path: str, headers: Headers) -> tuple[str, str] | None:
    """Return the bundle and the origin that a browser asks about before it reads; None for other requests."""
    origin, wanted = headers.get("origin"), headers.get("access-control-request-method", "")
    bundle_id = bundle_read(wanted, path)
    return (bundle_id, origin) if method == "OPTIONS" and bundle_id and origin else None


def answer(database: Database, bundle_id: str, origin: str) -> dict[str, str]:
    """Return the headers of the answer to `preflight`; nothing is allowed to origins that no link names.

    Where the links that name one have ended, its pages may still ask, and read that they have: what a request
    gets is decided by the link that it brings.
    """
    with database.read() as connection:
        if not is_named_by_a_link(connection, bundle_id, origin):
            return {"vary": "origin"}
    return {
        **allowing(origin),
        "vary": "origin",
        "access-control-allow-methods": "GET, HEAD",
        "access-control-allow-headers": "authorization, range, if-none-match, if-range",
        "access-control-max-age": str(_PREFLIGHT_S),
    }


def allowing(origin: str) -> dict[str, str]:
    """Return the headers that let scripts of `origin` read a response, which varies with the origin."""
    return {
        "access-control-allow-origin": origin,
        "access-control-expose-headers": "content-length, content-range, etag",
    }
