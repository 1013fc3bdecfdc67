"""Quotas of an organisation: bytes, unfinished jobs, GPU minutes of a month.

Each is checked in the transaction that uses it, and while it is checked no other transaction of the
organisation can: concurrent requests never pass a limit together.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from sqlalchemy import Connection, func, select

from lambent_server.accounts import organisations, usage
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.tenancy import Tenant
from lambent_server.storage import reservations

BYTES = "max_bytes"
JOBS = "max_queued_jobs"
GPU_MINUTES = "max_gpu_minutes"
RETRY_AFTER_S = 30


@dataclass(frozen=True, kw_only=True, slots=True)
class Quotas:
    """The limits of one organisation; None: no limit."""

    bytes: float | None
    jobs: int
    gpu_minutes: float | None


def quotas_of(connection: Connection, tenant: Tenant, settings: Settings) -> Quotas:
    """Return the limits of an organisation: its own, else those of the settings."""
    own = organisations.find(connection, tenant)

    def limit(name: str, default: float) -> float | None:
        value = getattr(own, name, None)
        return (default if value is None else value) or None

    jobs = limit("max_jobs", settings.max_queued_jobs)
    return Quotas(
        bytes=limit("max_bytes", settings.max_organisation_bytes),
        # A server without any limit here would be stopped by one loop in a script.
        jobs=int(settings.max_queued_jobs if jobs is None else jobs),
        gpu_minutes=limit("max_gpu_minutes", settings.max_gpu_minutes),
    )


def lock(connection: Connection, tenant: Tenant) -> None:
    """Let no other transaction of the organisation check its jobs until this one ends."""
    # SQLite has only one writer anyway.
    if connection.dialect.name == "postgresql":
        connection.execute(select(func.pg_advisory_xact_lock(func.hashtext(f"quota {tenant.id}"))))


def check_jobs(limit: int, used: int, more: int) -> None:
    """Refuse more unfinished jobs than the organisation may have."""
    if used + more > limit:
        detail = (
            f"{used} jobs are unfinished, {limit} are allowed; wait until some have ended, cancel some, or "
            "ask the operator for more (`lambent admin quota --jobs`)"
        )
        raise _used_up(429, "quota_jobs", detail, JOBS, limit, used)


def check_gpu_minutes(limit: float | None, used: float, more: float) -> None:
    """Refuse a job on GPUs if its minutes, and those used and promised this month, are above the limit."""
    if limit is not None and used + more > limit:
        detail = (
            f"{used:.0f} of {limit:.0f} GPU minutes of this month are used or promised to unfinished jobs, "
            f"and this job may take {more:.0f}; use fewer GPUs or a smaller preset, wait for the next month, "
            "or ask the operator for more (`lambent admin quota --gpu-minutes`)"
        )
        raise _used_up(429, "quota_gpu_minutes", detail, GPU_MINUTES, limit, round(used, 1), retry_s=3600)


def check_bytes(
    connection: Connection,
    tenant: Tenant,
    settings: Settings,
    more: float = 0.0,
    *,
    of: Collection[str] = (),
) -> None:
    """Refuse to store `more` bytes if they and those that are stored or reserved are above the limit.

    `of` are the hashes of the files that these bytes belong to: what is reserved for them does not count.
    After a blob was added in the same transaction, its sum is locked until the end, so that two
    transactions cannot both find that theirs still fits.
    """
    limit = quotas_of(connection, tenant, settings).bytes
    if limit is None:
        return
    used = used_bytes(connection, tenant, but=of)
    if used + more > limit:
        raise bytes_used_up(limit, used, more)


def used_bytes(connection: Connection, tenant: Tenant, but: Collection[str] = ()) -> float:
    """Return how many bytes of the quota are used: by files that are stored, and by those that may be sent.

    Of the latter, those of the hashes `but` are left out.
    """
    return usage.amount(connection, tenant, usage.BYTES) + reservations.amount(connection, tenant, but)


def reserve_bytes(
    connection: Connection, tenant: Tenant, settings: Settings, sizes: Mapping[str, int], *, refuse: bool
) -> None:
    """Keep room for files by hash and size in bytes; with `refuse` only if there is that much."""
    # SQLite has only one writer, and otherwise two plans could each find that theirs fits.
    lock(connection, tenant)
    if refuse:
        check_bytes(connection, tenant, settings, float(sum(sizes.values())), of=sizes.keys())
    reservations.keep(connection, tenant, sizes, settings)


def bytes_used_up(limit: float, used: float, more: float) -> Problem:
    """Return the problem of `more` bytes than there is room for."""
    detail = f"this needs {used + more:.0f} bytes with what is stored or being sent, {limit:.0f} are allowed"
    return _used_up(507, "quota_bytes", f"{detail}; delete something", BYTES, limit, used)


def month_used(connection: Connection, tenant: Tenant) -> float:
    """Return the GPU minutes of the runs that have ended this month."""
    return usage.amount(connection, tenant, usage.month_of(now())) / 60.0


def _used_up(
    status: int,
    code: str,
    detail: str,
    name: str,
    limit: float,
    used: float,
    *,
    retry_s: int = RETRY_AFTER_S,
) -> Problem:
    return Problem(
        status,
        code,
        detail,
        retryable=True,
        headers={"retry-after": str(retry_s)},
        members={"quota": {"name": name, "limit": limit, "used": used}},
    )
