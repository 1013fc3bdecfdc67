"""Arguments of `Client` are checked before anything is sent, and what it returns shows itself in one line."""

from pathlib import Path

import pytest
from lambent import Client, Event, Job, Progress, SceneReport, UsageProblemError
from lambent.fetch import FetchedBundle
from lambent.models import Artifact, FileEntry, Finding
from support.fake_server import FakeServer

ARTIFACT = Artifact(name="a.png", sha256="0" * 64)


@pytest.fixture
def server():
    return FakeServer()


@pytest.fixture
def client(server):
    return Client("http://127.0.0.1:1", "secret", transport=server.transport, sleep=lambda seconds: None)


@pytest.mark.parametrize(
    "call",
    [
        lambda client: client.job(""),
        lambda client: client.job(None),
        lambda client: client.job("../presets"),
        lambda client: client.job("a", wait_s="1"),
        lambda client: client.job("a", wait_s=-1),
        lambda client: client.scene(7),
        lambda client: client.scene_report("a b"),
        lambda client: client.cancel(Job(id="job_1", state="running")),
        lambda client: client.retry(""),
        lambda client: client.logs("a/b"),
        lambda client: client.events("a", after="3"),
        lambda client: client.artifacts("?x"),
        lambda client: client.batch(""),
        lambda client: client.cancel_batch(None),
        lambda client: client.batch_artifacts("#"),
        lambda client: client.delete(None),
        lambda client: client.watch("job_1"),
        lambda client: client.watch(["a", 7]),
        lambda client: client.watch(["a"], silence_s=float("nan")),
        lambda client: client.push(None),
        lambda client: client.push(""),
        lambda client: client.push_environment(["sky.exr"]),
        lambda client: client.fetch("a", None),
        lambda client: client.peek("bundle_1", 7),
        lambda client: client.download("a.png", "a.png"),
        lambda client: client.download(ARTIFACT, None),
        lambda client: client.read_artifact("a.png"),
        lambda client: client.submit("", preset="fast"),
        lambda client: client.submit("a", preset=None),
        lambda client: client.submit("a", seed=-1),
        lambda client: client.submit("a", seed=1.5),
        lambda client: client.submit("a", gpus=True),
        lambda client: client.submit("a", params={"stage_one.num_rays": 512}),
        lambda client: client.submit("a", labels=["set=cups"]),
        lambda client: client.submit_batch("order"),
        lambda client: client.render("bundle_1", environments=[7], cameras={}),
        lambda client: client.render("bundle_1", environments=["env_1"], cameras="turntable"),
        lambda client: list(client.jobs(limit=-1)),
        lambda client: list(client.jobs(state=None)),
        lambda client: Client(7),
        lambda client: Client(api_key=7),
        lambda client: Client(data=7),
    ],
)
def test_a_wrong_argument_is_refused_before_anything_is_sent(server, client, call):
    with pytest.raises(UsageProblemError) as raised:
        call(client)
    assert raised.value.code == "client.argument"
    assert raised.value.advice
    assert server.requests == []


def test_an_object_where_its_id_belongs_is_answered_with_the_id(client):
    with pytest.raises(UsageProblemError, match="give its id, 'job_1'"):
        client.cancel(Job(id="job_1", state="running"))


def test_the_key_is_in_no_repr(client):
    assert repr(client) == "Client('http://127.0.0.1:1')"
    assert "secret" not in repr(client.address)


def test_answers_show_what_is_set_in_one_short_line():
    progress = Progress(stage="cache", fraction=0.25)
    job = Job(
        id="job_1",
        state="running",
        params={f"stage_one.setting_{n}": "1" for n in range(9)},
        progress=progress,
    )
    assert "progress=Progress(stage='cache', fraction=0.25)" in repr(job)
    findings = tuple(Finding(code="scene.a", message="m" * 500) for _ in range(9))
    files = (FileEntry(path="a", size_bytes=1, sha256="0"),) * 9
    answers = (
        job,
        ARTIFACT,
        SceneReport(scene_id="a", findings=findings),
        Event(job_id="a", type="log", message="m" * 500),
        FetchedBundle(bundle_id="bundle_1", path=Path("b"), files=files),
    )
    for each in answers:
        assert repr(each).startswith(f"{type(each).__name__}(")
        assert "\n" not in repr(each)
        assert len(repr(each)) < 250
    assert "findings=(9 of them)" in repr(answers[2])
    assert repr(Job(id="a", state="queued")) == "Job(id='a', state='queued', kind='train')"
