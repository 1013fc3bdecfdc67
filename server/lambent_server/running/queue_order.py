"""The next job to start: of the tenant with the fewest runs, and of these the one that has waited longest.

Among the jobs of that tenant the highest priority comes first, then the oldest job: a priority never gets a
job ahead of another tenant's. Jobs of one tenant with the same priority and number of GPUs form a group, in
which the oldest comes first. Only the oldest of each group are compared, so the length of the queue does not
matter.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Integer, Select, and_, bindparam, func, not_, select

from lambent_server.database.model import JobRow
from lambent_server.database.rows import one
from lambent_server.database.schema import jobs
from lambent_server.database.service_schema import tenant_turns
from lambent_server.database.tenancy import Tenant, across_tenants, add_if_absent, change
from lambent_server.jobs.rows import is_startable
from lambent_server.renders.rows import waits_for_parts


def _startable(table: Any) -> ColumnElement[bool]:
    return and_(is_startable(table), not_(waits_for_parts(table)))


def _least(condition: Callable[[Any], ColumnElement[bool]]) -> Any:
    """Return the id of the first job that may start, in the order of the index."""
    job = jobs.alias()
    statement = select(job.c.id).where(_startable(job), condition(job.c))
    order = (job.c.gpus, job.c.priority, job.c.tenant_id, job.c.id)
    return statement.order_by(*order).limit(1).correlate_except(job).scalar_subquery()


def _all_heads() -> Select[Any]:
    """Return the query of the oldest job of every group: the index leads from each group to the next one."""
    free_gpus = bindparam("free_gpus", type_=Integer)
    columns = ("id", "gpus", "priority", "tenant_id")
    first = _least(lambda job: job.gpus <= free_gpus)
    heads = select(*(jobs.c[name] for name in columns)).where(jobs.c.id == first).cte("heads", recursive=True)
    at = heads.c
    same_gpus = _least(lambda job: and_(job.gpus == at.gpus, job.priority > at.priority))
    same_priority = _least(
        lambda job: and_(job.gpus == at.gpus, job.priority == at.priority, job.tenant_id > at.tenant_id)
    )
    others = _least(lambda job: and_(job.gpus > at.gpus, job.gpus <= free_gpus))
    following = func.coalesce(same_priority, same_gpus, others)
    head = jobs.alias()
    step = select(*(head.c[name] for name in columns)).select_from(heads).join(head, head.c.id == following)
    return select(heads.union_all(step))


_ANY = select(jobs.c.id).where(is_startable(), jobs.c.gpus <= bindparam("free_gpus")).limit(1)
_ALL_HEADS = _all_heads()
_NO_SORTING = select(*(func.set_config(f"enable_{name}", "off", True) for name in ("sort", "bitmapscan")))
"""Until the end of the transaction."""
_FOLLOWING = select(func.min(jobs.c.id)).where(
    _startable(jobs),
    jobs.c.gpus == bindparam("gpus"),
    jobs.c.priority == bindparam("priority"),
    jobs.c.tenant_id == bindparam("tenant_id"),
    jobs.c.id > bindparam("id"),
)
"""The job that follows a head in its group."""


@dataclass(frozen=True, slots=True)
class Head:
    """The oldest job of a group that has not been offered yet."""

    id: str
    gpus: int
    priority: int
    tenant_id: str


class QueueOrder:
    """The queue in the order in which jobs start, as of one moment."""

    def __init__(self, connection: Connection, load: Counter[str], free_gpus: int) -> None:
        """Read the groups that `free_gpus` suffice for.

        `load` has the number of runs by tenant; the caller keeps it up to date.
        """
        self._load = load
        self._turns: dict[str, int] = {}
        self._heads: list[Head] = []
        given = {"free_gpus": free_gpus}
        # Most rounds find nothing to start, and the whole query takes PostgreSQL a while to plan.
        if connection.execute(_ANY, given).first() is not None:
            if connection.dialect.name == "postgresql":
                # It would rather sort what is in the queue, anew for each group.
                connection.execute(_NO_SORTING)
            self._heads = [Head(**row) for row in connection.execute(_ALL_HEADS, given).mappings()]
            # Numbers, not times: servers whose clocks differ take from the same queue.
            turns = across_tenants(tenant_turns, tenant_turns.c.tenant_id, tenant_turns.c.turn)
            self._turns = dict(iter(connection.execute(turns)))

    def next(self, connection: Connection, free_gpus: int) -> JobRow | None:
        """Return the row of the next job that `free_gpus` suffice for; None after the last."""
        while fitting := [head for head in self._heads if head.gpus <= free_gpus]:
            head = min(fitting, key=self._place)
            self._heads.remove(head)
            follower = connection.execute(_FOLLOWING, asdict(head)).scalar_one_or_none()
            if follower is not None:
                self._heads.append(replace(head, id=follower))
            statement = across_tenants(jobs).where(jobs.c.id == head.id, is_startable())
            if (job := one(connection, statement, JobRow)) is not None:
                self._turns[head.tenant_id] = max(self._turns.values(), default=0) + 1
                return job
        return None

    def _place(self, head: Head) -> tuple[int, int, int, str]:
        """Return what the heads are sorted by."""
        return (self._load[head.tenant_id], self._turns.get(head.tenant_id, 0), -head.priority, head.id)


def had_turn(connection: Connection, tenant: Tenant) -> None:
    """Store that a run was just started for a tenant: with equally many runs, the others are next."""
    add_if_absent(connection, tenant, tenant_turns, turn=0)
    newest = select(func.max(tenant_turns.c.turn)).scalar_subquery()
    connection.execute(change(tenant, tenant_turns).values(turn=newest + 1))
