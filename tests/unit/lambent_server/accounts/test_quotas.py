"""Quotas of organisations: however many ask at once, no limit is passed, and every refusal names it."""

import contextlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from lambent_server.accounts import organisations, usage
from lambent_server.accounts.admission import Admission
from lambent_server.accounts.scopes import ALL
from lambent_server.accounts.who import Who
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.core.settings import Settings
from lambent_server.database.model import JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import blobs, jobs
from lambent_server.database.tenancy import Tenant, change, remove, rows
from lambent_server.http.rates import Rates
from lambent_server.jobs.queries import check_quota, insert_job, require_job
from lambent_server.jobs.rows import FAILED, RUNNING, move
from lambent_server.services import Services, open_services
from support.api import TENANT, Api, expect, expect_problem, opened, sha256
from support.databases import postgresql

CROWD = Tenant("crowd")


@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=pytest.mark.services)])
def services(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Services]:
    with contextlib.ExitStack() as stack:
        given: dict[str, Any] = {"data": tmp_path / "data", "disk_floor_bytes": 0, "max_queued_jobs": 10}
        if request.param == "postgresql":
            given["database"] = stack.enter_context(postgresql())
        services = open_services(Settings(**given, max_organisation_bytes=1000, max_gpu_minutes=60))
        with contextlib.closing(services.database):
            with services.database.write() as connection:
                organisations.create(connection, CROWD, "crowd")
            yield services


def at_once(act: Any, num: int = 30) -> int:
    """Return how many of so many concurrent attempts were not refused."""

    def attempt(number: int) -> bool:
        try:
            act(number)
        except Problem:
            return False
        return True

    with ThreadPoolExecutor(num) as pool:
        return sum(pool.map(attempt, range(num)))


def queue(services: Services, gpus: int = 0, reserved_s: float = 0.0, num: int = 1) -> None:
    values = {"kind": "train", "scene_id": "x", "preset": "tiny", "params": {}, "seed": 0, "priority": 0}
    with services.database.write() as connection:
        check_quota(connection, CROWD, services, num, reserved_s)
        insert_job(connection, CROWD, labels={}, gpus=gpus, gpu_s_reserved=reserved_s or None, **values)


def test_concurrent_submits_never_pass_the_number_of_jobs(services: Services):
    assert at_once(lambda _: queue(services)) == 10


def test_concurrent_submits_never_promise_more_gpu_minutes_than_there_are(services: Services):
    # Nine minutes each, of sixty.
    assert at_once(lambda _: queue(services, gpus=1, reserved_s=540.0)) == 6


def store(services: Services, folder: Path, number: int) -> None:
    data = f"{number:03d}".encode() * 30
    path = folder / f"file_{number}"
    path.write_bytes(data)
    who = Who(tenant=CROWD, kind="key", id="key_1", scopes=ALL)
    admission = Admission(who=who, settings=services.settings, action="put_file")
    write = services.database.write
    services.store.put_file(write, CROWD, path, sha256(data), "text/plain", admission)


def test_concurrent_uploads_never_pass_the_number_of_bytes_and_leave_none_behind(
    services: Services, tmp_path: Path
):
    # 90 bytes each, of 1000.
    assert at_once(lambda number: store(services, tmp_path, number)) == 11
    with services.database.read() as connection:
        sizes = list(connection.execute(rows(CROWD, blobs, blobs.c.size_bytes)).scalars())
        assert usage.amount(connection, CROWD, usage.BYTES) == sum(sizes) == 11 * 90
    kept = [name for digits in range(256) for name in services.store.listed(f"{digits:02x}")]
    assert len(kept) == 11


def test_the_sum_of_bytes_follows_every_change(services: Services, tmp_path: Path):
    for number in range(3):
        store(services, tmp_path, number)
    # Again: nothing new.
    store(services, tmp_path, 0)
    with services.database.write() as connection:
        assert usage.amount(connection, CROWD, usage.BYTES) == 270
        connection.execute(remove(CROWD, blobs).where(blobs.c.sha256 == sha256(b"000" * 30)))
        assert usage.amount(connection, CROWD, usage.BYTES) == 180
        connection.execute(remove(CROWD, blobs))
        assert usage.amount(connection, CROWD, usage.BYTES) == 0


def test_gpu_time_counts_when_a_run_ends_and_while_it_goes_on(services: Services):
    queue(services, gpus=2, reserved_s=60.0)
    with services.database.write() as connection:
        (job,) = many(connection, rows(CROWD, jobs), JobRow)
        assert move(connection, job, RUNNING, run=1, run_started_at=now() - 600)
        job = require_job(connection, CROWD, job.id)
    # 2 GPUs x 10 minutes of 60 are in use; 30 more fit, 45 do not.
    with pytest.raises(Problem) as refused:
        queue(services, gpus=1, reserved_s=45 * 60.0)
    assert refused.value.code == "quota_gpu_minutes"
    assert refused.value.members["quota"] == {"name": "max_gpu_minutes", "limit": 60.0, "used": 20.0}
    with services.database.write() as connection:
        assert move(connection, job, FAILED)
        # It has been moved already: not counted twice.
        assert not move(connection, job, FAILED)
        assert usage.amount(connection, CROWD, usage.month_of(now())) == pytest.approx(1200, abs=5)
    queue(services, gpus=1, reserved_s=30 * 60.0)


def test_a_run_across_the_turn_of_the_year_counts_in_both_months(services: Services):
    new_year = datetime(2027, 1, 1, tzinfo=UTC).timestamp()
    with services.database.write() as connection:
        usage.add_gpu_time(connection, CROWD, 2, new_year - 60, new_year + 30)
        assert usage.amount(connection, CROWD, "gpu_s 2026-12") == 120
        assert usage.amount(connection, CROWD, "gpu_s 2027-01") == 60


def test_an_organisation_may_have_limits_of_its_own(tmp_path: Path):
    with opened(tmp_path / "data", max_organisation_bytes=10) as api:
        limits = {each["name"]: each for each in expect(api.get("/v1/limits"), 200)["quotas"]}
        assert limits["max_bytes"] == {"name": "max_bytes", "limit": 10, "used": 0}
        with api.services.database.write() as connection:
            organisations.update(connection, TENANT, max_bytes=0, max_jobs=1)
        job = api.job()
        limits = {each["name"]: each for each in expect(api.get("/v1/limits"), 200)["quotas"]}
        assert limits["max_bytes"] == {"name": "max_bytes", "limit": None, "used": 2}
        assert limits["max_queued_jobs"] == {"name": "max_queued_jobs", "limit": 1, "used": 1}
        assert limits["max_gpu_minutes"]["limit"] is None
        body = {"scene_id": job["scene_id"], "preset": "tiny"}
        expect_problem(api.post("/v1/jobs", json=body), 429, "quota_jobs")


def test_uploads_beyond_the_quota_are_refused_at_the_plan_and_at_the_file(tmp_path: Path):
    with opened(tmp_path / "data", max_organisation_bytes=10) as api:
        scene = expect(api.post("/v1/scenes", json={"name": "s"}), 201)["id"]

        def plan(*files: bytes) -> Any:
            items = [
                {"path": f"{number}.json", "size": len(data), "sha256": sha256(data)}
                for number, data in enumerate(files)
            ]
            return api.post(f"/v1/scenes/{scene}/files:plan", json=items)

        problem = expect_problem(plan(b"12345678901"), 507, "quota_bytes")
        assert problem["quota"] == {"name": "max_bytes", "limit": 10, "used": 0}
        expect(plan(b"1234", b"5678"), 200)
        other = api.services.settings.data / "x"
        other.write_bytes(b"1234567")
        api.services.store.put_file(api.services.database.write, TENANT, other, sha256(b"1234567"), "x")
        answer = api.put(f"/v1/scenes/{scene}/files/{sha256(b'1234')}", content=b"1234")
        assert expect_problem(answer, 507, "quota_bytes")["quota"]["used"] == 7
        with api.services.database.write() as connection:
            connection.execute(remove(TENANT, blobs))
        expect(api.put(f"/v1/scenes/{scene}/files/{sha256(b'1234')}", content=b"1234"), 204)


def rates(**given: float) -> tuple[Rates, list[float]]:
    clock = [0.0]
    settings = Settings(client_writes_per_s=1, organisation_writes_per_s=3, writes_burst_s=5, **given)
    return Rates(settings, lambda: clock[0]), clock


def test_a_key_may_burst_and_then_writes_at_its_rate():
    buckets, clock = rates()
    for _ in range(5):
        buckets.take("t", "key a")
    with pytest.raises(Problem) as refused:
        buckets.take("t", "key a")
    assert (refused.value.status, refused.value.code) == (429, "rate_limited")
    assert refused.value.headers["retry-after"] == "1"
    buckets.take("t", "key b")
    clock[0] += 2.0
    for _ in range(2):
        buckets.take("t", "key a")
    with pytest.raises(Problem):
        buckets.take("t", "key a")


def test_the_keys_of_an_organisation_share_its_rate():
    buckets, _ = rates()
    for number in range(15):
        buckets.take("t", f"key {number}")
    with pytest.raises(Problem) as refused:
        buckets.take("t", "key new")
    assert refused.value.members["quota"]["of"] == "organisation"
    buckets.take("another", "key elsewhere")


def test_no_limit_is_no_limit():
    buckets = Rates(Settings(client_writes_per_s=0, organisation_writes_per_s=0), lambda: 0.0)
    for _ in range(10_000):
        buckets.take("t", "key a")


def test_buckets_that_are_full_are_forgotten():
    buckets, clock = rates()
    for number in range(10_001):
        buckets.take(f"t{number}", f"key {number}")
    clock[0] += 6.0
    buckets.take("t", "key a")
    buckets.take("t", "key a")
    assert len(buckets._buckets) < 10


def test_writes_are_limited_and_reads_are_not(tmp_path: Path):
    given = {"client_writes_per_s": 0.001, "writes_burst_s": 3000.0}
    with opened(tmp_path / "data", **given) as api:
        for _ in range(3):
            expect(api.post("/v1/scenes", json={"name": "s"}), 201)
        answer = api.post("/v1/scenes", json={"name": "s"})
        problem = expect_problem(answer, 429, "rate_limited")
        assert problem["retryable"]
        assert int(answer.headers["retry-after"]) >= 900
        expect(api.get("/v1/scenes"), 200)


def test_a_closed_organisation_lets_nobody_in(tmp_path: Path):
    with opened(tmp_path / "data") as api:
        with api.services.database.write() as connection:
            organisations.update(connection, TENANT, closed_at=now())
        expect_problem(api.get("/v1/scenes"), 401, "not_authenticated")
        with api.services.database.write() as connection:
            organisations.update(connection, TENANT, closed_at=None)
        expect(api.get("/v1/scenes"), 200)


def test_gpu_jobs_reserve_the_budget_of_their_preset(api_with_gpu: Api):
    limits = expect(api_with_gpu.get("/v1/limits"), 200)["quotas"][2]
    assert limits["used"] == 0
    api_with_gpu.job(gpus=1, preset="tiny")
    with api_with_gpu.services.database.read() as connection:
        reserved = connection.execute(rows(TENANT, jobs, jobs.c.gpu_s_reserved)).scalar_one()
    assert reserved >= 60
    assert expect(api_with_gpu.get("/v1/limits"), 200)["quotas"][2]["used"] == round(reserved / 60, 1)
    with api_with_gpu.services.database.write() as connection:
        connection.execute(change(TENANT, jobs).values(gpu_s_reserved=59 * 60.0))
    body = {"scene_id": api_with_gpu.scene(), "preset": "tiny", "gpus": 2}
    expect_problem(api_with_gpu.post("/v1/jobs", json=body), 429, "quota_gpu_minutes")


@pytest.fixture
def api_with_gpu(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data", local_gpus=2, max_gpu_minutes=60) as api:
        yield api
