"""Numbers of jobs by state, from sums that the database keeps: exact, and as quick with a million jobs."""

from collections import Counter
from typing import Any

from sqlalchemy import Connection, Select, delete, func, insert, select

from lambent_server.database.engine import Database
from lambent_server.database.schema import job_counts
from lambent_server.database.tenancy import Tenant, across_tenants, rows

FOLD_FROM = 1000
"""Number of rows from which they are replaced by their sums."""


def of_tenant(connection: Connection, tenant: Tenant) -> dict[str, int]:
    """Return the number of the tenant's jobs in each state."""
    return _sums(connection, rows(tenant, job_counts, job_counts.c.state, func.sum(job_counts.c.num_jobs)))


def of_all_tenants(connection: Connection) -> dict[str, int]:
    """Return the number of jobs of all tenants in each state."""
    return _sums(connection, across_tenants(job_counts, job_counts.c.state, func.sum(job_counts.c.num_jobs)))


def _sums(connection: Connection, statement: Select[Any]) -> dict[str, int]:
    sums = connection.execute(statement.group_by(job_counts.c.state))
    return {state: int(num_jobs) for state, num_jobs in sums if num_jobs}


def fold(database: Database, fold_from: int = FOLD_FROM) -> None:
    """Replace the rows of changes by their sums, if there are many."""
    with database.read() as connection:
        if connection.execute(select(func.count()).select_from(job_counts)).scalar_one() < fold_from:
            return
    with database.write() as connection:
        removed = delete(job_counts).returning(
            job_counts.c.tenant_id, job_counts.c.state, job_counts.c.num_jobs
        )
        sums: Counter[tuple[str, str]] = Counter()
        for tenant_id, state, num_jobs in connection.execute(removed):
            sums[tenant_id, state] += num_jobs
        values = [
            {"tenant_id": tenant_id, "state": state, "num_jobs": num_jobs}
            for (tenant_id, state), num_jobs in sums.items()
            if num_jobs
        ]
        if values:
            connection.execute(insert(job_counts), values)
