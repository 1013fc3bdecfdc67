"""Running sums of what organisations use: bytes that they store, GPU seconds of each month."""

from datetime import UTC, datetime

from sqlalchemy import Connection

from lambent_server.database.columns import insert_or
from lambent_server.database.people_schema import usage_sums
from lambent_server.database.tenancy import Tenant, rows

BYTES = "bytes"


def month_of(at: float) -> str:
    """Return the name of the sum of GPU seconds of the month (UTC) of a time (Unix seconds)."""
    return f"gpu_s {datetime.fromtimestamp(at, UTC):%Y-%m}"


def next_month(at: float) -> float:
    """Return when the month after that of a time begins (Unix seconds)."""
    day = datetime.fromtimestamp(at, UTC)
    year, month = (day.year + 1, 1) if day.month == 12 else (day.year, day.month + 1)
    return datetime(year, month, 1, tzinfo=UTC).timestamp()


def amount(connection: Connection, tenant: Tenant, name: str) -> float:
    """Return a sum; 0 if nothing was ever added to it."""
    statement = rows(tenant, usage_sums, usage_sums.c.amount).where(usage_sums.c.name == name)
    return float(connection.execute(statement).scalar_one_or_none() or 0.0)


def add_gpu_time(connection: Connection, tenant: Tenant, gpus: int, began: float, ended: float) -> None:
    """Add the time of a run on so many GPUs to the months in which it was."""
    while began < ended:
        until = min(ended, next_month(began))
        _add(connection, tenant, month_of(began), gpus * (until - began))
        began = until


def _add(connection: Connection, tenant: Tenant, name: str, more: float) -> None:
    statement = insert_or(connection, usage_sums).values(tenant_id=tenant.id, name=name, amount=more)
    connection.execute(
        statement.on_conflict_do_update(
            index_elements=[usage_sums.c.tenant_id, usage_sums.c.name],
            set_={"amount": usage_sums.c.amount + more},
        )
    )
