"""The application: the REST interface and everything around it."""

from typing import Any

from anyio import CapacityLimiter
from fastapi import Depends, FastAPI
from pydantic.json_schema import models_json_schema

from lambent_server.accounts.oidc import THREADS, Provider
from lambent_server.api.json_bodies import require_strict
from lambent_server.api.messages import ProblemDocument
from lambent_server.api.resources import describe_conditions
from lambent_server.bundles import embed_routes, file_routes, provenance_routes
from lambent_server.bundles import routes as bundles
from lambent_server.cluster.server_state import Notices
from lambent_server.cluster.shared_secrets import SHARE, shared_secret
from lambent_server.core.settings import Settings
from lambent_server.http import errors
from lambent_server.http.budget import Budget
from lambent_server.http.heads import HeadAsGet
from lambent_server.http.maintenance import Maintenance
from lambent_server.http.middleware import Gate
from lambent_server.http.request import App
from lambent_server.http.request_turns import take_turn
from lambent_server.http.scopes import check_scope, describe_scope, require_complete
from lambent_server.jobs import event_routes
from lambent_server.jobs import routes as jobs
from lambent_server.jobs.feed import Feed
from lambent_server.pages import about, pages
from lambent_server.people import key_routes, login_routes, sign_in_routes
from lambent_server.people import routes as people
from lambent_server.renders import environment_routes
from lambent_server.renders import routes as renders
from lambent_server.running import retry_routes
from lambent_server.running.health import Health
from lambent_server.scenes import routes as scenes
from lambent_server.scenes import upload_routes
from lambent_server.services import Services
from lambent_server.webhooks import routes as webhooks

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
        dependencies=[Depends(check_scope), Depends(take_turn)],
    )
    app.state.services = services
    errors.install(app)
    modules = (
        scenes,
        upload_routes,
        jobs,
        retry_routes,
        renders,
        event_routes,
        bundles,
        file_routes,
        environment_routes,
        about,
        login_routes,
        key_routes,
        webhooks,
        people,
        sign_in_routes,
        provenance_routes,
    )
    routers = [module.router for module in (*modules, embed_routes, pages)]
    require_complete(routers)
    require_strict(routers)
    app.state.routes = [route for router in routers for route in router.routes]
    for router in routers[: len(modules)]:
        app.include_router(router)
    app.add_api_route("/openapi.json", describe, include_in_schema=False)
    app.include_router(embed_routes.router)
    app.include_router(pages.router)
    return app


def make_app(services: Services, connections: int | None = None) -> tuple[FastAPI, App]:
    """Return the application, and the same wrapped in its gate; serve the latter.

    `connections` is the number of connections that the system allows, if fewer than in the settings.
    """
    app = _bare(services)
    app.state.health = Health(services)
    app.state.budget = budget = Budget(services.settings, connections)
    app.state.feed = Feed(services, budget)
    issuer = services.settings.oidc_issuer
    app.state.sign_ins = CapacityLimiter(THREADS)
    app.state.provider = None if issuer is None else Provider(services.settings)
    app.state.share_secret = shared_secret(services.database, services.settings, SHARE)
    inner = Maintenance(HeadAsGet(app), Notices(services.database))
    return app, Gate(inner, services, allowed_hosts(services.settings), app.state.share_secret, budget)


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
        if path.startswith("/v1/") and "get" in operations:
            describe_conditions(operations["get"])
        for operation in operations.values():
            describe_scope(operation)
            # FastAPI describes its own validation body, which is never sent.
            if "HTTPValidationError" in str(operation["responses"].get("422")):
                operation["responses"]["422"] = problem
            operation["responses"]["default"] = problem
    return description
