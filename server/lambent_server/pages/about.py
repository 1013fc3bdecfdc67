"""Information about the server: version, limits, presets, health and metrics."""

from importlib.metadata import version

from fastapi import APIRouter, Request, Response
from fastapi.responses import JSONResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from sqlalchemy import Connection

from lambent_server.accounts import quotas, usage
from lambent_server.api.about_messages import Health, Limits, Notice, Notices, Quota, Version
from lambent_server.api.messages import PresetList
from lambent_server.api.resources import ResourceRoute
from lambent_server.cluster.server_state import DRAIN, MAINTENANCE, read
from lambent_server.core.clock import rfc3339
from lambent_server.database.tenancy import Tenant
from lambent_server.http.common import ServicesOf, TenantOf, problems
from lambent_server.jobs import queries as job_queries
from lambent_server.people.sign_in_routes import sign_in_url
from lambent_server.running.health import NOTICES
from lambent_server.running.scrape import registry
from lambent_server.services import Services
from lambent_server.storage.paths import SCENE_SUFFIXES

router = APIRouter(tags=["about"], route_class=ResourceRoute)


@router.get("/v1/limits", responses=problems())
def get_limits(services: ServicesOf, tenant: TenantOf) -> Limits:
    """Return the limits of what the server accepts, and what this organisation uses of its quotas."""
    settings = services.settings
    computed = {"max_gpus", "max_queued_jobs", "scene_suffixes", "quotas"}
    with services.database.read() as connection:
        quotas_now = _quotas(services, connection, tenant)
        max_gpus = job_queries.max_gpus(connection, services)
    return Limits(
        **{name: getattr(settings, name) for name in set(Limits.model_fields) - computed},
        max_gpus=max_gpus,
        max_queued_jobs=next(int(each.limit or 0) for each in quotas_now if each.name == quotas.JOBS),
        scene_suffixes=sorted(SCENE_SUFFIXES),
        quotas=quotas_now,
    )


def _whole(limit: float | None) -> int | None:
    return None if limit is None else int(limit)


def _quotas(services: Services, connection: Connection, tenant: Tenant) -> list[Quota]:
    limits = quotas.quotas_of(connection, tenant, services.settings)
    stored = usage.amount(connection, tenant, usage.BYTES)
    unfinished = job_queries.num_unfinished(connection, tenant)
    promised = job_queries.promised_gpu_minutes(connection, tenant)
    minutes = quotas.month_used(connection, tenant) + promised
    return [
        Quota(name="max_bytes", limit=_whole(limits.bytes), used=int(stored)),
        Quota(name="max_queued_jobs", limit=_whole(limits.jobs), used=unfinished),
        Quota(name="max_gpu_minutes", limit=limits.gpu_minutes, used=round(minutes, 1)),
    ]


@router.get("/v1/presets", responses=problems())
def list_presets(tenant: TenantOf) -> PresetList:
    """Return the presets that a job can use."""
    known, default = job_queries.presets()
    return PresetList(items=list(known.values()), default=default)


@router.get("/v1/version")
def get_version(services: ServicesOf) -> Version:
    """Return the version of this server."""
    return Version(
        name="lambent", version=version("lambent"), api="v1", sign_in_url=sign_in_url(services.settings)
    )


@router.get("/v1/notices", responses=problems())
def get_notices(services: ServicesOf, tenant: TenantOf) -> Notices:
    """Return the notices of the operators: whether runs start, and whether changes are accepted."""
    with services.database.read() as connection:
        notices = read(connection)
    shown = {name: Notice(since=rfc3339(each.since), message=each.message) for name, each in notices.items()}
    return Notices(drain=shown.get(DRAIN), maintenance=shown.get(MAINTENANCE))


@router.get("/healthz")
async def get_health() -> Health:
    """Report that the process answers, without waiting for anything."""
    return Health(status="ok")


@router.get("/readyz", responses={503: {"model": Health, "description": "A part does not work."}})
async def get_readiness(request: Request) -> JSONResponse:
    """Report within two seconds whether all parts work; 503 if one does not.

    `files` counts files whose bytes are gone, `sandbox` is `partial` if this system lacks some of what
    surrounds processes that decode uploads; neither affects the status.
    """
    services: Services = request.app.state.services
    checks = {"controller": "ok", **await request.app.state.health.checks()}
    told = checks.pop(NOTICES).split()
    controller = getattr(request.app.state, "controller", None)
    if controller is not None and controller.is_stuck:
        checks["controller"] = "stuck"
    if services.wakeups.closing:
        checks["controller"] = "ending"
    well = all(value == "ok" for value in checks.values())
    reconciler = getattr(request.app.state, "reconciler", None)
    missing = 0 if reconciler is None else reconciler.num_missing
    # Those that were found damaged since the reconciler looked are missing from then on.
    missing = max(missing, len(services.store.checks.damaged))
    checks["files"] = f"{missing} missing" if missing else "ok"
    layers = getattr(request.app.state, "sandbox", None)
    if layers is not None:
        checks["sandbox"] = "partial" if layers.missing else "ok"
    # Operators want it so, and reads are answered: neither affects the status.
    otherwise = "off" if checks["database"] == "ok" else "unknown"
    checks |= {name: "on" if name in told else otherwise for name in (DRAIN, MAINTENANCE)}
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
