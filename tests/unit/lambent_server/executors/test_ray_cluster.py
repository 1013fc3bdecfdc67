"""The line to a Ray cluster, with a program in place of the one that speaks with Ray."""

import contextlib
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from lambent_server.core.settings import Settings
from lambent_server.executors import ExecutorAwayError, ray_cluster
from lambent_server.executors.ray_cluster import Cluster, RayProcess
from support.live_server import wait_until

PROGRAM = """#!{python} -S
import json, os, sys
print("begun", file=sys.stderr, flush=True)
for line in sys.stdin:
    request = json.loads(line)
    if request["op"] == "end":
        os._exit(1)
    if request["op"] == "never":
        continue
    answer = {{"error": "no such actor"}} if request["op"] == "wrong" else {{"result": request["given"]}}
    print(json.dumps({{"id": request["id"], **answer}}), flush=True)
"""


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Settings:
    program = tmp_path / "program"
    program.write_text(PROGRAM.format(python=sys.executable))
    program.chmod(0o700)
    monkeypatch.setattr(sys, "executable", str(program))
    return Settings(data=tmp_path, ray_address="10.0.0.1:6379", ray_poll_s=0.01, ray_away_s=30.0)


@pytest.fixture
def link(settings: Settings) -> Iterator[RayProcess]:
    with contextlib.closing(RayProcess(settings, "ours")) as link:
        yield link


def test_answers_reach_those_who_asked_and_errors_say_what_ray_said(link: RayProcess):
    assert link.call("look", offsets={"job_a/1": 3}) == {"offsets": {"job_a/1": 3}}
    with pytest.raises(ExecutorAwayError, match="no such actor"):
        link.call("wrong")
    with pytest.raises(ExecutorAwayError, match=r"within 0\.1 s"):
        link.call("never", 0.1)
    # What comes too late is for nobody.
    assert link.call("look", name="x") == {"name": "x"}
    assert link._waiting == {}


def test_the_end_of_the_process_is_noticed_at_once(link: RayProcess):
    began = time.monotonic()
    with pytest.raises(ExecutorAwayError, match=r"has ended; see ray-link\.log"):
        link.call("end", 60.0)
    assert time.monotonic() - began < 30.0
    with pytest.raises(ExecutorAwayError, match="has ended"):
        link.call("look", 60.0)
    assert link._waiting == {}


def test_the_log_of_the_process_is_continued_and_put_aside_when_it_is_long(settings: Settings):
    log = settings.data / "ray-link.log"
    log.write_bytes(b"why the one before ended\n")
    with contextlib.closing(RayProcess(settings, "ours")) as link:
        link.call("look")
    assert log.read_bytes() == b"why the one before ended\nbegun\n"
    log.write_bytes(b"x" * (ray_cluster.LOG_BYTES + 1))
    with contextlib.closing(RayProcess(settings, "ours")) as link:
        link.call("look")
    assert log.read_bytes() == b"begun\n"
    assert log.with_suffix(".log.1").stat().st_size == ray_cluster.LOG_BYTES + 1


@dataclass
class FakeLink:
    """What a process would answer."""

    looks: list[dict[str, Any]] = field(default_factory=list)
    fails: bool = False
    closed: bool = False

    def call(self, op: str, _timeout_s: float = 0.0, **given: Any) -> Any:
        if self.fails:
            raise ExecutorAwayError("no answer from Ray within 15 s")
        self.looks.append(given)
        answered = {"node": "n1", "silent_s": 0.5, "offset": 3, "log": "eA==", "log_left": 4}
        waits = {"offset": -1, "log": "", "silent_s": None}
        nodes = [{"id": "n1", "name": "one", "resources": {"CPU": 2.0}}]
        return {"actors": {"job_a/1": answered, "job_b/1": waits}, "nodes": nodes, "available": {"CPU": 1.0}}

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def links(monkeypatch: pytest.MonkeyPatch) -> list[FakeLink]:
    """Return the processes that are started, in their order."""
    made: list[FakeLink] = []
    monkeypatch.setattr(ray_cluster, "RayProcess", lambda *_: made.append(FakeLink()) or made[-1])
    monkeypatch.setattr(ray_cluster, "probe", lambda _: "closed")
    return made


def test_a_look_says_who_is_there_and_hands_new_output_on(
    settings: Settings, links: list[FakeLink], monkeypatch: pytest.MonkeyPatch
):
    taken: list[tuple[str, int]] = []
    cluster = Cluster(
        settings, "ours", lambda: {"job_a/1": 3}, lambda run, piece: taken.append((run, piece["offset"]))
    )
    with pytest.raises(ExecutorAwayError, match="not been reached yet"):
        cluster.look()
    cluster._turn()
    look = cluster.look()
    assert links[0].looks == [{"offsets": {"job_a/1": 3}}]
    # None of a run whose output nobody wants.
    assert taken == [("job_a/1", 3)]
    assert [(name, actor.answered, actor.log_left) for name, actor in look.actors.items()] == [
        ("job_a/1", True, 4),
        ("job_b/1", False, 0),
    ]
    assert (look.nodes[0].name, look.available) == ("one", {"CPU": 1.0})
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + settings.ray_away_s + 1.0)
    with pytest.raises(ExecutorAwayError):
        cluster.look()
    with pytest.raises(ExecutorAwayError):
        cluster.call("signal", name="job_a/1", number=15)
    assert len(links[0].looks) == 1


def test_a_process_that_does_not_answer_is_ended_and_another_one_started(
    settings: Settings, links: list[FakeLink]
):
    cluster = Cluster(settings, "ours", dict, lambda *_: None)
    cluster.start()
    try:
        wait_until(lambda: links and links[0].looks)
        links[0].fails = True
        wait_until(lambda: len(links) == 2 and links[1].looks)
        assert links[0].closed
        # What was seen last is good until then.
        assert "job_a/1" in cluster.look().actors
    finally:
        cluster.close()
    assert links[1].closed


@pytest.mark.parametrize(("access", "reason"), [("open", "runs anyone"), ("away", "does not answer")])
def test_no_process_is_started_for_a_cluster_that_obeys_everybody_or_nobody(
    settings: Settings,
    links: list[FakeLink],
    monkeypatch: pytest.MonkeyPatch,
    access: str,
    reason: str,
):
    monkeypatch.setattr(ray_cluster, "probe", lambda _: access)
    cluster = Cluster(settings, "ours", dict, lambda *_: None)
    with pytest.raises(ExecutorAwayError, match=reason):
        cluster._turn()
    assert links == []
