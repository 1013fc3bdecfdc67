"""Every error of the framework as a problem document; none of its own bodies is sent."""

from typing import Any

import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from lambent_core.pictures import UNCLEAR
from starlette.exceptions import HTTPException
from starlette.routing import Match

from lambent_server.api.problems import MEDIA_TYPE, Detail, Problem
from lambent_server.http.middleware import INTERNAL
from lambent_server.storage.outages import outage_of

log = structlog.get_logger()
_CODES = {
    404: "route_not_found",
    405: "method_not_allowed",
    # The framework's own message, used only for bodies that it cannot read.
    400: "invalid_json",
    415: "unsupported_media_type",
}
MAX_ERRORS = 100


def respond(request: Request, problem: Problem) -> Response:
    """Return the response for a problem."""
    document = problem.document(request.state.request_id)
    request.state.refused = problem.code
    return JSONResponse(document, problem.status, headers=problem.headers, media_type=MEDIA_TYPE)


def _pointer(location: tuple[Any, ...]) -> str:
    """Return a JSON pointer into the body, or into another part of the request ("#/query/limit")."""
    parts = location[1:] if location and location[0] == "body" else location
    return "#" + "".join("/" + str(part).replace("~", "~0").replace("/", "~1") for part in parts)


def _validation(error: RequestValidationError) -> Problem:
    faults = error.errors()
    if any(each["type"] == "json_invalid" for each in faults):
        return Problem(
            400, "invalid_json", "the body is not valid JSON", errors=(Detail("#", str(faults[0]["msg"])),)
        )
    details = tuple(
        Detail(_pointer(each["loc"]), str(each["msg"]).removeprefix("Value error, "))
        for each in faults[:MAX_ERRORS]
    )
    code = UNCLEAR if {each["type"] for each in faults} == {UNCLEAR} else "invalid_request"
    return Problem(422, code, f"{len(faults)} value(s) cannot be used", errors=details)


def allowed_methods(request: Request) -> list[str]:
    """Return the methods of a path, sorted: the framework names those of the first of its routes only."""
    routes = [*request.app.state.routes, *request.app.router.routes]
    # The routers that the application includes are among its routes, without methods of their own.
    known = [route for route in routes if getattr(route, "methods", None)]
    matching = [route for route in known if route.matches(request.scope)[0] != Match.NONE]
    methods = {method for route in matching for method in route.methods}
    return sorted(methods | ({"HEAD"} if "GET" in methods else set()))


def install(app: FastAPI) -> None:
    """Replace the framework's error handlers."""

    @app.exception_handler(Problem)
    async def problem(request: Request, error: Problem) -> Response:
        return respond(request, error)

    @app.exception_handler(RequestValidationError)
    async def validation(request: Request, error: RequestValidationError) -> Response:
        return respond(request, _validation(error))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        code = _CODES.get(error.status_code, "refused")
        headers = dict(error.headers or {})
        if error.status_code == 405:
            headers["Allow"] = ", ".join(allowed_methods(request))
        return respond(request, Problem(error.status_code, code, str(error.detail), headers=headers))

    @app.exception_handler(Exception)
    async def anything(request: Request, error: Exception) -> Response:
        return respond(request, outage_of(error) or INTERNAL)
