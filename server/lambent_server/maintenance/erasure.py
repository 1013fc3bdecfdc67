"""Deletion of an organisation with everything that belongs to it, down to the last byte.

First it is closed, then its jobs are cancelled; once no process is left, every row is deleted in one
transaction, whatever table it is in. A request that began before is rolled back, because nothing is recorded
of an organisation that is closed. The sweep then removes its blobs, as it removes any that nothing refers to:
bytes that another organisation has too stay for that one.
"""

import shutil
from collections.abc import Iterable

from sqlalchemy import Connection, Table, delete, func, insert, literal, select

from lambent_server.accounts import audit, organisations, usage
from lambent_server.accounts.who import Who
from lambent_server.api.problems import conflict
from lambent_server.core.clock import now
from lambent_server.database import schema  # noqa: F401 (all tables belong to the metadata)
from lambent_server.database.columns import metadata
from lambent_server.database.people_schema import (
    audit_entries,
    audit_heads,
    audit_permits,
    members,
    usage_sums,
    users,
)
from lambent_server.database.schema import blobs, garbage, job_counts, jobs
from lambent_server.database.tenancy import Tenant, change, remove, rows
from lambent_server.jobs.queries import cancel, require_job
from lambent_server.jobs.rows import CANCELLING, FINAL, is_unfinished
from lambent_server.receiving.direct import folder_of
from lambent_server.services import Services

# Removed in another way: by the sweep, by their own module, or when nothing adds to them any more.
_LATER = frozenset({blobs, garbage, usage_sums, audit_entries, audit_heads, audit_permits, job_counts})


def tables_of_tenants() -> list[Table]:
    """Return every table whose rows belong to a tenant, those that refer to others first."""
    return [table for table in reversed(metadata.sorted_tables) if "tenant_id" in table.c]


def count(connection: Connection, tenant: Tenant) -> dict[str, int]:
    """Return how many rows of an organisation each table has; tables without any are left out."""
    counts = {
        table.name: connection.execute(rows(tenant, table, func.count())).scalar_one()
        for table in tables_of_tenants()
    }
    return {name: int(num_rows) for name, num_rows in sorted(counts.items()) if num_rows}


def close(services: Services, who: Who) -> int:
    """Close an organisation, cancel its jobs, and return how many still have a process or have not ended.

    It is that of `who`.
    """
    tenant = who.tenant
    # Apart from the jobs: whoever has locked one of them may wait for the log, which this locks.
    with services.database.write() as connection:
        if organisations.require(connection, tenant).closed_at is None:
            organisations.update(connection, tenant, closed_at=now())
            audit.record(connection, who, "org close", tenant.id)
    with services.database.read() as connection:
        unfinished = rows(tenant, jobs, jobs.c.id).where(is_unfinished()).order_by(jobs.c.id)
        job_ids = list(connection.execute(unfinished).scalars())
    for job_id in job_ids:
        with services.database.write() as connection:
            job = require_job(connection, tenant, job_id, lock=True)
            # Of one that is being cancelled this waits for the end only.
            if job.state not in (CANCELLING, *FINAL):
                cancel(connection, job)
                audit.record(connection, who, "jobs cancel", job_id)
    with services.database.read() as connection:
        return len(_going_on(connection, tenant))


def _going_on(connection: Connection, tenant: Tenant) -> list[str]:
    busy = (jobs.c.state.not_in(FINAL)) | (jobs.c.handle.is_not(None))
    return list(connection.execute(rows(tenant, jobs, jobs.c.id).where(busy)).scalars())


def erase(services: Services, who: Who) -> None:
    """Delete every row of the organisation of `who`, which is closed; blobs go with the next sweeps.

    Raises `organisation_busy` while a job has a process.
    """
    tenant = who.tenant
    with services.database.write() as connection:
        # Before anything is looked at: what an operator adds now waits, and is rolled back when this is done.
        audit.lock(connection, tenant)
        if organisations.require(connection, tenant).closed_at is None:
            raise conflict(
                "organisation_open", f"close {tenant.id} first, so that nothing is added meanwhile"
            )
        busy = _going_on(connection, tenant)
        if busy:
            detail = f"jobs {', '.join(busy[:5])} have not ended; a running server ends them within a minute"
            raise conflict("organisation_busy", detail)
        folders = list(connection.execute(rows(tenant, jobs, jobs.c.id)).scalars())
        _delete_rows(connection, tenant)
        nobody = Who(tenant=audit.SERVER, kind=who.kind, id=who.id, scopes=who.scopes)
        audit.record(connection, nobody, "org delete", tenant.id)
    _delete_files(services, tenant, folders)


def _delete_rows(connection: Connection, tenant: Tenant) -> None:
    own = list(connection.execute(rows(tenant, members, members.c.user_id)).scalars())
    for table in tables_of_tenants():
        if table not in _LATER:
            connection.execute(remove(tenant, table))
    # The triggers of `jobs` have just counted their removal.
    connection.execute(remove(tenant, job_counts))
    connection.execute(remove(tenant, usage_sums).where(usage_sums.c.name != usage.BYTES))
    audit.remove_all(connection, tenant)
    # Due at once, which a claim or an upload of the last minute still delays.
    connection.execute(remove(tenant, garbage))
    due = select(blobs.c.sha256, blobs.c.tenant_id, literal(0.0)).where(blobs.c.tenant_id == tenant.id)
    connection.execute(insert(garbage).from_select(["sha256", "tenant_id", "at"], due))
    connection.execute(change(tenant, blobs).values(touched_at=0.0))
    elsewhere = select(members.c.user_id)
    connection.execute(delete(users).where(users.c.id.in_(own), users.c.id.not_in(elsewhere)))


def _delete_files(services: Services, tenant: Tenant, folders: Iterable[str]) -> None:
    """Delete logs and work folders on this machine, and what was sent to the store and not taken over."""
    for name in folders:
        shutil.rmtree(services.settings.runs / name, ignore_errors=True)
    bucket = services.store.bucket
    if bucket is not None:
        for key, *_ in bucket.listed(f"{folder_of(tenant)}/"):
            bucket.delete(key)
        for key, upload_id, _ in bucket.uploads(f"{folder_of(tenant)}/"):
            bucket.abort(key, upload_id)


def is_erased(services: Services, tenant: Tenant) -> bool:
    """Return whether nothing of an organisation is left, its blobs among it."""
    with services.database.read() as connection:
        return not count(connection, tenant)
