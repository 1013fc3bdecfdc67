"""Output of runs: copied in pieces by the server that looks after the run, and put away once, at its end."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from lambent_server.core.clock import now
from lambent_server.database.cluster_schema import run_log_pieces, servers
from lambent_server.database.schema import jobs
from lambent_server.jobs import logs as run_logs
from lambent_server.jobs.logs import KEPT_BYTES, PIECE_BYTES, LogCopier, file_of, tail
from support.api import TENANT, Api, opened
from support.runs import Others

HERE, THERE = "server_here", "server_there"
ALL = 2**30


class Machine:
    """A server with a data folder of its own, on the database and the store of the others."""

    def __init__(self, api: Api, name: str, folder: Path) -> None:
        settings = api.services.settings.model_copy(update={"data": folder})
        for made in (settings.runs, settings.scratch):
            made.mkdir(parents=True, exist_ok=True)
        self.services = replace(api.services, settings=settings)
        self.others = Others(id=name, leads=False, alive={HERE, THERE})
        self.copier = LogCopier(self.services, self.others)

    def write(self, job: str, data: bytes) -> None:
        """Let the run of a job write on this machine."""
        path = file_of(self.services, job, 1)
        path.parent.mkdir(exist_ok=True)
        with path.open("ab") as file:
            file.write(data)

    def read(self, job: str) -> bytes | None:
        """Return the output as this server gives it to people."""
        return tail(self.services, TENANT, job, 1, ALL)


@pytest.fixture
def api(tmp_path: Path) -> Iterator[Api]:
    with opened(tmp_path / "data") as api:
        yield api


@pytest.fixture
def here(api: Api, tmp_path: Path) -> Machine:
    return Machine(api, HERE, tmp_path / "here")


@pytest.fixture
def there(api: Api, tmp_path: Path) -> Machine:
    return Machine(api, THERE, tmp_path / "there")


def change(api: Api, job: str, **values: Any) -> None:
    with api.services.database.write() as connection:
        given = {"updated_at": now(), **values}
        connection.execute(jobs.update().where(jobs.c.id == job).values(**given))


def running(api: Api, server: str) -> str:
    """Return a job with a run that a server looks after."""
    job = str(api.job()["id"])
    change(api, job, state="running", run=1, handle={"actor": "x", "run": "x", "server": server})
    return job


def move(api: Api, job: str, server: str) -> None:
    change(api, job, handle={"actor": "x", "run": "x", "server": server})


def end(api: Api, job: str, **values: Any) -> None:
    change(api, job, state="succeeded", handle=None, **values)


def pieces(api: Api) -> list[Any]:
    with api.services.database.read() as connection:
        statement = run_log_pieces.select().order_by(run_log_pieces.c.start)
        return list(connection.execute(statement).mappings())


def test_output_is_read_everywhere_while_a_run_goes_on_and_after_its_end(
    api: Api, here: Machine, there: Machine
):
    job = running(api, HERE)
    here.write(job, b"one ")
    here.copier.turn()
    here.write(job, b"two")
    assert (there.read(job), here.read(job)) == (b"one ", b"one two")
    here.copier.turn()
    assert there.read(job) == b"one two"
    here.write(job, b" three")
    end(api, job)
    here.copier.turn()
    assert pieces(api) == []
    assert there.read(job) == b"one two three"


def test_output_of_a_run_that_another_server_has_taken_over_is_not_put_away_before_its_end(
    api: Api, here: Machine, there: Machine
):
    job = running(api, HERE)
    here.write(job, b"one ")
    here.copier.turn()
    # The other server has the whole output again, from the cluster.
    move(api, job, THERE)
    there.write(job, b"one two ")
    # The first server, which was only away for a while.
    here.copier.turn()
    assert [row["server_id"] for row in pieces(api)] == [HERE]
    there.copier.turn()
    assert {row["server_id"] for row in pieces(api)} == {THERE}
    here.copier.turn()
    # What it has itself ends too early.
    assert here.read(job) == there.read(job) == b"one two "
    there.write(job, b"three")
    end(api, job)
    here.copier.turn()
    assert {row["server_id"] for row in pieces(api)} == {THERE}
    there.copier.turn()
    assert pieces(api) == []
    assert here.read(job) == there.read(job) == b"one two three"


def test_output_is_put_away_by_who_has_the_file_if_the_last_server_of_the_run_died(
    api: Api, here: Machine, there: Machine
):
    job = running(api, THERE)
    there.write(job, b"one")
    there.copier.turn()
    here.write(job, b"one two")
    end(api, job)
    here.copier.turn()
    assert {row["server_id"] for row in pieces(api)} == {THERE}
    here.others.alive.clear()
    here.copier.turn()
    assert pieces(api) == []
    assert there.read(job) == b"one two"


@pytest.mark.parametrize("leads", [True, False])
@pytest.mark.parametrize("goes_on", [False, True])
def test_pieces_of_servers_that_are_not_known_any_more_are_put_away_by_the_leader(
    api: Api, here: Machine, there: Machine, leads: bool, goes_on: bool
):
    job = running(api, THERE)
    there.write(job, b"one")
    there.copier.turn()
    if goes_on:
        change(api, job, updated_at=now() - 7200.0)
    else:
        end(api, job, updated_at=now() - 7200.0)
    here.others.leads = leads
    here.copier.turn()
    assert (pieces(api) == []) == (leads and not goes_on)
    assert here.read(job) == b"one"


@pytest.mark.parametrize(("known", "age_s"), [(True, 7200.0), (False, 60.0)])
def test_pieces_of_a_server_that_may_come_back_for_them_are_left(
    api: Api, here: Machine, there: Machine, known: bool, age_s: float
):
    job = running(api, THERE)
    there.write(job, b"one")
    there.copier.turn()
    end(api, job, updated_at=now() - age_s)
    if known:
        numbers = dict.fromkeys(("protocol", "slots", "gpus"), 1)
        times = dict.fromkeys(("started_at", "beat_at", "expires_at"), 0.0)
        texts = dict.fromkeys(("host", "hostname", "url", "version"), "")
        with api.services.database.write() as connection:
            connection.execute(servers.insert().values(id=THERE, endpoints=[], **numbers, **times, **texts))
    here.others.leads = True
    here.copier.turn()
    assert len(pieces(api)) == 1


def test_the_last_four_mebibytes_of_a_run_are_copied_and_no_more_is_kept(
    api: Api, here: Machine, there: Machine
):
    job = running(api, HERE)
    whole = b""
    for letter in (b"a", b"b", b"c", b"d"):
        data = letter * (KEPT_BYTES // 2) + b"\n"
        whole += data
        here.write(job, data)
        here.copier.turn()
        held = sum(len(row["data"]) for row in pieces(api))
        assert held <= KEPT_BYTES + 2 * PIECE_BYTES
    assert there.read(job)[-KEPT_BYTES:] == whole[-KEPT_BYTES:]
    # More at once than is copied.
    here.write(job, b"e" * (KEPT_BYTES + PIECE_BYTES) + b"end")
    here.copier.turn()
    end(api, job)
    here.copier.turn()
    assert pieces(api) == []
    assert there.read(job) == b"e" * (KEPT_BYTES - 3) + b"end"


def test_the_end_of_the_output_is_copied_when_the_server_ends(api: Api, here: Machine, there: Machine):
    job = running(api, HERE)
    here.copier.start()
    here.write(job, b"stopped after a checkpoint")
    end(api, job)
    # Its next round would have been in some seconds.
    here.copier.close()
    assert there.read(job) == b"stopped after a checkpoint"


def test_the_output_of_a_deleted_job_is_not_kept(api: Api, here: Machine, there: Machine):
    job = running(api, HERE)
    here.write(job, b"one")
    here.copier.turn()
    end(api, job)
    with api.services.database.write() as connection:
        run_logs.forget(connection, TENANT, job)
    assert pieces(api) == []
    assert there.read(job) is None
