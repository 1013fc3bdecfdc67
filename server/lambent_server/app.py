"""The application: the REST interface and everything around it."""

from typing import Any

from fastapi import FastAPI
from pydantic.json_schema import models_json_schema

from lambent_server.health import Health
from lambent_server.http import errors
from lambent_server.http.identity import LoginCodes
from lambent_server.http.middleware import App, Gate
from lambent_server.messages import ProblemDocument
from lambent_server.routes import (
    about,
    bundles,
    embed,
    environments,
    events,
    files,
    jobs,
    keys,
    login,
    pages,
    renders,
    scenes,
)
from lambent_server.secrets import read_or_create_secret
from lambent_server.services import Services
from lambent_server.settings import Settings

_PUBLIC = frozenset({"/healthz", "/readyz", "/v1/version", "/v1/login", "/v1/shares:open"})
LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


def _bare(services: Services | None) -> FastAPI:
    app = FastAPI(
        title="Lambent",
        version="1",
        summary="Photographs of an object in, a relightable asset out.",
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
        generate_unique_id_function=lambda route: route.name,
    )
    app.state.services = services
    errors.install(app)
    for module in (scenes, jobs, renders, events, bundles, files, environments, about, login, keys):
        app.include_router(module.router)
    app.add_api_route("/openapi.json", describe, include_in_schema=False)
    app.include_router(embed.router)
    app.include_router(pages.router)
    return app


def make_app(services: Services) -> tuple[FastAPI, App]:
    """Return the application, and the same wrapped in its gate; serve the latter."""
    app = _bare(services)
    app.state.login_codes = LoginCodes(services.settings.login_code_s)
    app.state.health = Health(services)
    app.state.feed = events.Feed(services)
    app.state.share_secret = read_or_create_secret(services.settings.data / "share.secret")
    return app, Gate(app, services, allowed_hosts(services.settings), app.state.share_secret)


def allowed_hosts(settings: Settings) -> frozenset[str]:
    """Return the host names that the server accepts, against DNS rebinding."""
    return LOOPBACK | {settings.host} | set(settings.allowed_hosts)


def describe() -> dict[str, Any]:
    """Return the OpenAPI description."""
    app = _bare(None)
    description = app.openapi()
    schemas = description["components"]["schemas"]
    _, extra = models_json_schema(
        [(ProblemDocument, "serialization")], ref_template="#/components/schemas/{model}"
    )
    schemas |= extra["$defs"]
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    description["components"]["securitySchemes"] = {
        "key": {"type": "http", "scheme": "bearer"},
        "session": {"type": "apiKey", "in": "cookie", "name": "lambent_session"},
    }
    problem = {
        "description": "Something is wrong with the request or the server.",
        "content": {"application/problem+json": {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}},
    }
    for path, operations in description["paths"].items():
        for operation in operations.values():
            if path not in _PUBLIC:
                operation["security"] = [{"key": []}, {"session": []}]
            # FastAPI describes its own validation body, which is never sent.
            if "HTTPValidationError" in str(operation["responses"].get("422")):
                operation["responses"]["422"] = problem
            operation["responses"]["default"] = problem
    return description
