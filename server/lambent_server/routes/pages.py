"""The page at `/` and its files."""

from importlib import resources
from typing import Annotated

from fastapi import APIRouter, Path, Response

from lambent_server.problems import not_found
from lambent_server.routes.common import problems

router = APIRouter(include_in_schema=False)

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css",
    ".js": "text/javascript",
    ".svg": "image/svg+xml",
}
_FOLDER = resources.files("lambent_server").joinpath("web")


@router.get("/", response_class=Response)
def get_page() -> Response:
    """Return the page that lists jobs."""
    return _send("index.html")


@router.get("/assets/{name}", response_class=Response, responses=problems(404))
def get_asset(name: Annotated[str, Path(max_length=100)]) -> Response:
    """Return a file of the page."""
    return _send(name)


def _send(name: str) -> Response:
    known = {each.name: each for each in _FOLDER.iterdir() if each.is_file()}
    suffix = name[name.rfind(".") :] if "." in name else ""
    if name not in known or suffix not in _TYPES:
        raise not_found("file", name)
    headers = {"cache-control": "no-cache"}
    return Response(known[name].read_bytes(), headers=headers, media_type=_TYPES[suffix])
