"""Watching: no event lost, none twice, whatever the connection does."""

import httpx2
import pytest
from lambent import Client
from lambent.errors import UnreachableError
from lambent.models import Event, Job
from support.fake_server import FakeServer, Time, event, event_stream


@pytest.fixture
def server():
    """Return a server with one running job."""
    server = FakeServer()
    server.jobs["a"] = {"id": "a", "state": "running"}
    return server


def watch(server, jobs=("a",), **options):
    time = Time()
    timing = {"sleep": time.sleep, "clock": time.clock}
    with Client("http://127.0.0.1:1", transport=server.transport, **timing) as client:
        yield from client.watch(list(jobs), **options)


def finish(server, job_id="a", state="succeeded"):
    server.jobs[job_id] = {"id": job_id, "state": state}


def seqs(updates):
    return [update.seq for update in updates if isinstance(update, Event)]


def ending(server, *events, then=None):
    """Return a stream after which the job has succeeded."""

    def answer(request):
        finish(server)
        return event_stream(*events, then=then)

    return answer


def test_a_finished_job_is_one_update(server):
    finish(server)
    assert [update.state for update in watch(server)] == ["succeeded"]


def test_the_stream_gives_the_job_its_events_and_the_final_job(server):
    server.streams.append(ending(server, event("a", 1), event("a", 2, type="state", state="succeeded")))
    updates = list(watch(server))
    assert isinstance(updates[0], Job)
    assert updates[0].state == "running"
    assert seqs(updates) == [1, 2]
    assert isinstance(updates[-1], Job)
    assert updates[-1].is_final


def test_a_lost_stream_is_taken_up_after_the_last_event_and_repeats_are_dropped(server):
    last_ids = []

    def second(request):
        last_ids.append(request.headers["Last-Event-ID"])
        return ending(server, event("a", 2), event("a", 3, state="succeeded", type="state"))(request)

    server.streams += [
        lambda request: event_stream(event("a", 1), event("a", 2), then=httpx2.ReadError("lost")),
        second,
    ]
    assert seqs(watch(server)) == [1, 2, 3]
    assert last_ids == ["a:2"]


def test_the_caller_can_start_after_an_event(server):
    server.streams.append(ending(server, event("a", 5), event("a", 6, state="succeeded", type="state")))
    assert seqs(watch(server, after={"a": 5})) == [6]
    stream = server.requests.index("GET /v1/events")
    assert server.headers[stream]["Last-Event-ID"] == "a:5"


def test_two_mute_streams_lead_to_polling(server):
    server.streams += [lambda request: event_stream(then=httpx2.ReadTimeout("silence"))] * 2
    server.events["a"] = [event("a", 1), event("a", 2, type="state", state="succeeded")]
    polls = []

    def count(request):
        if request.url.path.endswith("/events") and "jobs" in request.url.path:
            polls.append(request)
            finish(server)

    server.faults.append(count)
    assert seqs(watch(server)) == [1, 2]
    assert len(polls) == 1


def test_an_answer_that_is_no_stream_leads_to_polling(server):
    server.streams += [lambda request: httpx2.Response(200, text="<html>")] * 2
    server.events["a"] = [event("a", 1, type="state", state="succeeded")]
    server.faults.append(lambda request: finish(server) if request.url.path == "/v1/jobs/a/events" else None)
    assert seqs(watch(server)) == [1]


def test_a_final_state_of_an_earlier_run_does_not_end_the_watch(server):
    server.streams += [
        lambda request: event_stream(event("a", 1, type="state", state="failed"), event("a", 2)),
        ending(server, event("a", 3, type="state", state="succeeded", run=2)),
    ]
    updates = list(watch(server))
    assert seqs(updates) == [1, 2, 3]
    assert updates[-1].state == "succeeded"


def test_a_server_that_is_away_for_a_while_is_waited_for(server):
    failures = iter(range(12))

    def away(request):
        if request.url.path == "/v1/events" and next(failures, None) is not None:
            raise httpx2.ConnectError("refused")

    server.faults.append(away)
    server.streams.append(ending(server, event("a", 1, type="state", state="succeeded")))
    assert seqs(watch(server)) == [1]
    assert "GET /v1/jobs/a/events" not in server.requests, (
        "a server that was unavailable is streamed from again"
    )


def test_patience_ends(server):
    def away(request):
        if request.url.path != "/v1/jobs/a":
            raise httpx2.ConnectError("refused")

    server.faults.append(away)
    with pytest.raises(UnreachableError):
        list(watch(server, patience_s=30.0))


def test_two_jobs_are_watched_until_both_have_ended(server):
    server.jobs["b"] = {"id": "b", "state": "running"}

    def first(request):
        finish(server)
        return event_stream(event("a", 1, type="state", state="succeeded"), event("b", 1))

    def second(request):
        assert [value for key, value in request.url.params.multi_items() if key == "job"] == ["b"]
        finish(server, "b", "failed")
        return event_stream(event("b", 2, type="state", state="failed"))

    server.streams += [first, second]
    ended = [update for update in watch(server, ("a", "b")) if isinstance(update, Job) and update.is_final]
    assert [(job.id, job.state) for job in ended] == [("a", "succeeded"), ("b", "failed")]


def test_an_unknown_state_is_not_final_and_unknown_fields_are_ignored():
    job = Job.from_json(
        {"id": "a", "state": "paused", "colour": "blue", "progress": {"psnr": 20.0, "new": 1}}
    )
    assert not job.is_final
    assert job.progress.psnr == 20.0


def test_every_page_of_jobs_is_listed(server):
    for index in range(5):
        server.jobs[f"j{index}"] = {"id": f"j{index}", "state": "queued"}
    with Client("http://127.0.0.1:1", transport=server.transport) as client:
        assert len(list(client.jobs())) == 6
        assert len(list(client.jobs(limit=3))) == 3
