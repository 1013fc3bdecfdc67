"""Waiting for jobs and batches: time-outs, progress, and servers that are unavailable."""

import httpx2
import pytest
from lambent import Client, LambentError, UnreachableError, UsageProblemError, WaitTimeoutError
from lambent.waiting import SHORT_S
from support.fake_server import FakeServer, Time


@pytest.fixture
def time():
    return Time()


@pytest.fixture
def server():
    """Return a server with one running job."""
    server = FakeServer()
    server.jobs["a"] = {"id": "a", "state": "running", "progress": {"stage": "train", "fraction": 0.25}}
    return server


@pytest.fixture
def client(server, time):
    with Client(
        "http://127.0.0.1:1", transport=server.transport, sleep=time.sleep, clock=time.clock
    ) as client:
        yield client


def later(server, time, changes):
    """Change the job at the given times, before a request is answered."""

    def act(request):
        for at in sorted(changes):
            if time.now >= at:
                server.jobs["a"] |= changes[at]

    server.faults.append(act)


def test_a_job_is_returned_when_it_is_final_however_it_ended(client, server, time):
    later(server, time, {5.0: {"state": "failed"}})
    assert client.wait("a").state == "failed"
    assert 5.0 <= time.now <= 5.0 + SHORT_S


def test_a_time_out_raises_and_leaves_the_job_alone(client, server, time):
    with pytest.raises(WaitTimeoutError, match=r"job a is running after 3\.5 s \(train, 25%\)") as caught:
        client.wait("a", timeout_s=3.5)
    assert caught.value.code == "client.wait_timeout"
    assert isinstance(caught.value, TimeoutError)
    assert isinstance(caught.value, LambentError)
    assert time.now == pytest.approx(3.5)
    assert set(server.requests) == {"GET /v1/jobs/a"}


def test_a_time_out_of_zero_looks_once(client, server, time):
    with pytest.raises(WaitTimeoutError):
        client.wait("a", timeout_s=0)
    assert (len(server.requests), time.now) == (1, 0.0)
    server.jobs["a"]["state"] = "succeeded"
    assert client.wait("a", timeout_s=0).is_final


def test_the_server_is_never_asked_to_wait_longer_than_is_left(client, server, time):
    asked = []
    server.faults.append(lambda request: asked.append((time.now, float(request.url.params["wait"]))))
    with pytest.raises(WaitTimeoutError):
        client.wait("a", timeout_s=2.5)
    assert [wait for _, wait in asked] == [pytest.approx(2.5 - now) for now, _ in asked]
    assert len(asked) == 4, "once more when the time is over"


def test_progress_is_called_for_every_change_and_for_no_repeat(client, server, time):
    half = {"progress": {"stage": "train", "fraction": 0.5}}
    later(server, time, {0.0: {"state": "queued"}, 3.0: {"state": "running"}, 6.0: half})
    later(server, time, {9.0: {"state": "succeeded"}})
    seen = []
    client.wait("a", progress=lambda job: seen.append((job.state, job.progress.fraction)))
    assert seen == [("queued", 0.25), ("running", 0.25), ("running", 0.5), ("succeeded", 0.5)]


def test_what_progress_raises_ends_the_wait(client):
    def refuse(job):
        raise KeyError("enough")

    with pytest.raises(KeyError, match="enough"):
        client.wait("a", progress=refuse)


def test_a_server_that_is_away_for_a_while_is_waited_for(client, server, time):
    def away(request):
        if 1.0 <= time.now < 300.0:
            raise httpx2.ConnectError("refused")

    server.faults.append(away)
    later(server, time, {400.0: {"state": "succeeded"}})
    assert client.wait("a").state == "succeeded"


def test_a_server_that_stays_away_ends_the_wait(client, server, time):
    def away(request):
        if time.now >= 1.0:
            raise httpx2.ConnectError("refused")

    server.faults.append(away)
    with pytest.raises(UnreachableError):
        client.wait("a")
    assert 600.0 < time.now < 660.0
    with pytest.raises(WaitTimeoutError, match="did not answer for 20 s"):
        client.wait("a", timeout_s=20)


def test_a_batch_is_waited_for_in_the_same_way(client, server, time):
    def answer(request):
        state = "succeeded" if time.now >= 4.0 else "running"
        return httpx2.Response(200, json={"id": "batch_1", "state": state, "num_done": int(time.now)})

    server.faults.append(answer)
    with pytest.raises(WaitTimeoutError, match="batch batch_1 is running after 2 s"):
        client.wait_batch("batch_1", timeout_s=2)
    seen = []
    assert client.wait_batch("batch_1", progress=lambda batch: seen.append(batch.num_done)).is_final
    assert seen == [2, 3, 4]


@pytest.mark.parametrize("given", [{"timeout_s": -1}, {"timeout_s": "60"}, {"progress": "print"}])
def test_other_arguments_are_refused(client, given):
    with pytest.raises(UsageProblemError, match=r"client\.argument"):
        client.wait("a", **given)
