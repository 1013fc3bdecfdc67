"""Information about the server: version, limits, presets, health and metrics."""

from importlib.metadata import version

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest

from lambent_server import job_queries
from lambent_server.clock import now
from lambent_server.messages import Health, Limits, PresetList, Version
from lambent_server.metrics import registry
from lambent_server.paths import SCENE_SUFFIXES
from lambent_server.routes.common import ServicesOf, TenantOf, problems
from lambent_server.services import Services

router = APIRouter(tags=["about"])


@router.get("/v1/limits", responses=problems())
def get_limits(services: ServicesOf, tenant: TenantOf) -> Limits:
    """Return the limits of what the server accepts."""
    settings = services.settings
    names = set(Limits.model_fields) - {"max_gpus", "scene_suffixes"}
    return Limits(
        **{name: getattr(settings, name) for name in names},
        max_gpus=job_queries.max_gpus(services),
        scene_suffixes=sorted(SCENE_SUFFIXES),
    )


@router.get("/v1/presets", responses=problems())
def list_presets(tenant: TenantOf) -> PresetList:
    """Return the presets that a job can use."""
    known, default = job_queries.presets()
    return PresetList(items=list(known.values()), default=default)


@router.get("/v1/version")
def get_version() -> Version:
    """Return the version of this server."""
    return Version(name="lambent", version=version("lambent"), api="v1")


@router.get("/healthz")
async def get_health() -> Health:
    """Report that the process answers, without waiting for anything."""
    return Health(status="ok")


@router.get("/readyz", responses={503: {"model": Health, "description": "A part does not work."}})
async def get_readiness(request: Request) -> JSONResponse:
    """Report within two seconds whether all parts work; 503 if one does not.

    `files` counts files whose bytes are gone; it does not affect the status.
    """
    services: Services = request.app.state.services
    checks = {"controller": "ok", **await request.app.state.health.checks()}
    controller = getattr(request.app.state, "controller", None)
    if controller is not None and now() - controller.turned_at > 30 + 10 * services.settings.tick_s:
        checks["controller"] = "stuck"
    if services.wakeups.closing:
        checks["controller"] = "ending"
    well = all(value == "ok" for value in checks.values())
    reconciler = getattr(request.app.state, "reconciler", None)
    missing = 0 if reconciler is None else reconciler.num_missing
    checks["files"] = f"{missing} missing" if missing else "ok"
    health = Health(status="ok" if well else "unavailable", checks=checks)
    return JSONResponse(health.model_dump(), 200 if well else 503)


@router.get(
    "/metrics",
    response_class=Response,
    responses={**problems(), 200: {"content": {"text/plain": {"schema": {"type": "string"}}}}},
)
def get_metrics(services: ServicesOf, tenant: TenantOf) -> Response:
    """Return metrics for Prometheus."""
    return Response(generate_latest(registry(services)), media_type=CONTENT_TYPE_LATEST)
