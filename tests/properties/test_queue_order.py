"""Jobs start in the order of the rule, whichever way the database finds the next one."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lambent_server.database.engine import Database
from lambent_server.database.schema import jobs, render_orders
from lambent_server.database.service_schema import tenant_turns
from lambent_server.database.tenancy import Tenant
from lambent_server.jobs.rows import FINAL
from lambent_server.running.queue_order import QueueOrder, had_turn
from sqlalchemy import delete, insert
from support.databases import without_tables

SUMMARY = 2
"""Number of parts of each order, which is the number of its summary too."""


@dataclass(frozen=True)
class Waiting:
    """A job of the queue, or one that is like it in all but one respect."""

    id: str
    tenant: str
    priority: int
    gpus: int
    state: str
    has_process: bool
    order: str | None
    shard: int | None


@st.composite
def queues(draw: st.DrawFn) -> list[Waiting]:
    """Return jobs whose ids are in no order of any other kind."""
    numbers = draw(st.lists(st.integers(0, 99), unique=True, max_size=14))
    found = []
    for number in numbers:
        order = draw(st.sampled_from([None, None, "order_1", "order_2"]))
        found.append(
            Waiting(
                id=f"job_{number:02d}",
                tenant=draw(st.sampled_from("abc")),
                priority=draw(st.integers(-1, 1)),
                gpus=draw(st.integers(0, 2)),
                state=draw(st.sampled_from(["queued"] * 4 + ["succeeded", "retry_wait"])),
                has_process=draw(st.integers(0, 9)) == 0,
                order=order,
                shard=None if order is None else draw(st.integers(0, SUMMARY)),
            )
        )
    return found


def expected(
    queue: list[Waiting], load: Counter[str], free_gpus: int, num_slots: int, turns: dict[str, int]
) -> list[str]:
    """Return the jobs that start, from sorting all of them again for every one."""
    load, turns, found = load.copy(), turns.copy(), []
    waiting = [job for job in queue if job.state == "queued" and not job.has_process]
    waiting = [job for job in waiting if job.shard != SUMMARY or not has_open_part(job, queue)]
    while waiting and len(found) < num_slots:
        waiting.sort(key=lambda job: (load[job.tenant], turns.get(job.tenant, 0), -job.priority, job.id))
        job = waiting.pop(0)
        if job.gpus <= free_gpus:
            found.append(job.id)
            free_gpus -= job.gpus
            load[job.tenant] += 1
            turns[job.tenant] = max(turns.values(), default=0) + 1
    return found


def has_open_part(summary: Waiting, queue: list[Waiting]) -> bool:
    parts = [job for job in queue if job.order == summary.order and job.shard != SUMMARY]
    return any(job.state not in FINAL for job in parts)


def chosen(database: Database, load: Counter[str], free_gpus: int, num_slots: int) -> list[str]:
    """Return the jobs that the queue offers, as the controller asks for them."""
    load, found = load.copy(), []
    with database.read() as connection:
        queue = QueueOrder(connection, load, free_gpus)
        while len(found) < num_slots and (job := queue.next(connection, free_gpus)) is not None:
            found.append(job.id)
            free_gpus -= job.gpus
            load[job.tenant_id] += 1
    return found


def store(database: Database, queue: list[Waiting], turns: dict[str, int] | None = None) -> None:
    common = {
        "kind": "train",
        "scene_id": "x",
        "preset": "tiny",
        "params": {},
        "labels": {},
        "adjustments": {},
    }
    common |= {"seed": 0, "created_at": 0.0, "updated_at": 0.0}
    values: list[dict[str, Any]] = [
        {
            **common,
            "id": job.id,
            "tenant_id": job.tenant,
            "priority": job.priority,
            "gpus": job.gpus,
            "state": job.state,
            "handle": {"pid": 1, "run": "x/1"} if job.has_process else None,
            "order_id": job.order,
            "shard": job.shard,
        }
        for job in queue
    ]
    with database.write() as connection:
        connection.execute(delete(jobs))
        connection.execute(delete(tenant_turns))
        for tenant, turn in (turns or {}).items():
            connection.execute(insert(tenant_turns).values(tenant_id=tenant, turn=turn))
        if values:
            connection.execute(insert(jobs), values)


@pytest.fixture(scope="module", params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def database(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Database]:
    with without_tables(request.param, tmp_path_factory.mktemp("queue")) as database:
        database.migrate()
        with database.write() as connection:
            order = {"tenant_id": "a", "kind": "batch", "name": "x", "spec": {}, "num_pictures": 2}
            order |= {"num_shards": SUMMARY, "created_at": 0.0}
            connection.execute(insert(render_orders), [{**order, "id": f"order_{n}"} for n in (1, 2)])
        yield database


@pytest.mark.timeout(300)
@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    queue=queues(),
    load=st.dictionaries(st.sampled_from("abc"), st.integers(0, 3)),
    free_gpus=st.integers(0, 3),
    num_slots=st.integers(1, 6),
    turns=st.dictionaries(st.sampled_from("abc"), st.integers(0, 3)),
)
def test_the_next_job_is_the_first_of_the_sorted_queue(
    database: Database,
    queue: list[Waiting],
    load: dict[str, int],
    free_gpus: int,
    num_slots: int,
    turns: dict[str, int],
):
    store(database, queue, turns)
    busy = Counter(load)
    wanted = expected(queue, busy, free_gpus, num_slots, turns)
    assert chosen(database, busy, free_gpus, num_slots) == wanted


def test_the_rule_is_few_runs_then_priority_then_age(database: Database):
    job = Waiting("job_5", "a", 0, 0, "queued", False, None, None)
    queue = [
        job,
        replace(job, id="job_6", priority=1),
        replace(job, id="job_7", tenant="b"),
        replace(job, id="job_4", gpus=1),
    ]
    store(database, queue)
    assert chosen(database, Counter(a=1), 0, 4) == ["job_7", "job_6", "job_5"]
    assert chosen(database, Counter(b=5), 1, 4) == ["job_6", "job_4", "job_5", "job_7"]


def test_no_priority_starves_another_tenant_on_a_single_slot(database: Database):
    urgent = [Waiting(f"job_{n}", "a", 100, 0, "queued", False, None, None) for n in range(8)]
    modest = [
        Waiting(f"job_9{n}", tenant, -5, 0, "queued", False, None, None) for n, tenant in enumerate("bc")
    ]
    store(database, [*urgent, *modest])
    started = []
    for _ in range(6):
        # Each run has ended before the next one starts, so that no tenant ever has a run.
        (job_id,) = chosen(database, Counter(), 0, 1)
        started.append(job_id)
        tenant = next(job.tenant for job in (*urgent, *modest) if job.id == job_id)
        with database.write() as connection:
            had_turn(connection, Tenant(tenant))
            connection.execute(delete(jobs).where(jobs.c.id == job_id))
    assert started == ["job_0", "job_90", "job_91", "job_1", "job_2", "job_3"]
