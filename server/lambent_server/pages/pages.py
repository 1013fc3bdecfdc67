"""The web pages and their files."""

from typing import Annotated

import lambent_pages
from fastapi import APIRouter, Header, Path, Response
from starlette.convertors import StringConvertor, register_url_convertor
from starlette.exceptions import HTTPException

router = APIRouter(include_in_schema=False)

MatchHeader = Annotated[str | None, Header(alias="If-None-Match", max_length=2000)]
EncodingHeader = Annotated[str | None, Header(alias="Accept-Encoding", max_length=2000)]
AcceptHeader = Annotated[str | None, Header(alias="Accept", max_length=2000)]


class _PagePath(StringConvertor):
    """A path outside the REST interface."""

    regex = "(?!v1/)[A-Za-z0-9._/-]+"


register_url_convertor("page", _PagePath())


@router.get("/", response_class=Response)
def get_start(if_none_match: MatchHeader = None, accept_encoding: EncodingHeader = None) -> Response:
    """Return the page of scenes, jobs and bundles."""
    return _send("jobs.html", if_none_match, accept_encoding, accept="text/html")


@router.get("/{path:page}", response_class=Response)
def get_page(
    path: Annotated[str, Path(max_length=240)],
    if_none_match: MatchHeader = None,
    accept_encoding: EncodingHeader = None,
    accept: AcceptHeader = None,
) -> Response:
    """Return a page, or a file of the pages."""
    return _send(path, if_none_match, accept_encoding, accept=accept or "")


def _send(path: str, if_none_match: str | None, accept_encoding: str | None, *, accept: str) -> Response:
    page, status = lambent_pages.find(path, accept_encoding=accept_encoding), 200
    if page is None and path.endswith(".html") and not lambent_pages.are_built():
        page, status = lambent_pages.not_built(), 503
    elif page is None:
        # Browsers name the type when a person follows a link, and not when a page asks for a file.
        if "text/html" not in accept:
            raise HTTPException(404)
        page, status = lambent_pages.not_found(), 404
    elif lambent_pages.is_named(page.headers["etag"], if_none_match):
        return Response(status_code=304, headers=page.headers)
    return Response(page.content, status, page.headers)
