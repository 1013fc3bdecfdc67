"""The route class of every operation: JSON bodies are read in one way, and say what they are."""

from collections.abc import Callable, Coroutine, Iterable
from typing import Any

from fastapi import APIRouter, Request, Response
from fastapi.routing import APIRoute
from starlette.requests import ClientDisconnect

from lambent_server.api.outside_text import parse_json, unsupported
from lambent_server.api.problems import Problem

_REMEDY = "send Content-Type: application/json (curl -H 'Content-Type: application/json' -d '{...}')"


class StrictRoute(APIRoute):
    """A route whose JSON body has passed `parse_json` before the framework sees it."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of a request."""
        handle = super().get_route_handler()
        if self.body_field is None:
            return handle

        async def read(request: Request) -> Response:
            try:
                body = await request.body()
            except ClientDisconnect as error:
                detail = "the connection closed before the end of the body"
                raise Problem(400, "body_incomplete", detail) from error
            if body:
                _check_headers(request)
                # The framework takes the value that a request has parsed once.
                request._json = parse_json(body)
            return await handle(request)

        return read


def _check_headers(request: Request) -> None:
    given = request.headers.get("content-type", "")
    kind = given.partition(";")[0].strip().lower()
    if not (kind == "application/json" or (kind.startswith("application/") and kind.endswith("+json"))):
        value = f"the header is {given[:100]!r}" if given else "the header is missing"
        detail = f"the body of this request is JSON, and its Content-Type does not say so: {value}; {_REMEDY}"
        raise unsupported(detail, "Content-Type")
    coding = request.headers.get("content-encoding", "identity").strip().lower()
    if coding not in ("identity", ""):
        raise unsupported(
            f"the body is encoded as {coding[:40]!r}, and encoded bodies are not accepted", "Content-Encoding"
        )


def require_strict(routers: Iterable[APIRouter]) -> None:
    """Raise LookupError for a route that reads JSON in another way."""
    routes = [route for router in routers for route in router.routes if isinstance(route, APIRoute)]
    reading = [route for route in routes if route.body_field is not None]
    if names := [route.name for route in reading if not isinstance(route, StrictRoute)]:
        raise LookupError(f"give the routers of these routes the route class StrictRoute: {', '.join(names)}")
