"""The executor without Ray: a cluster that is as a test says."""

import base64
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import grpc
import pytest
from lambent_server.core.settings import ServeError, Settings
from lambent_server.executors import ExecutorAwayError, Gone, Handle, Launch
from lambent_server.executors.chosen import open_executor
from lambent_server.executors.installed import installed
from lambent_server.executors.ray import RayExecutor
from lambent_server.executors.ray_cluster import Actor, Look, Node, link_environment, probe

RUN = "job_a/3"
HANDLE: Handle = {"actor": RUN, "run": RUN, "executor": "ray", "gpus": []}
ACTOR = Actor(
    answered=True,
    silent_s=0.1,
    node="n1",
    exit_code=None,
    refused="",
    needs={"cpus": 1.0, "gpus": 0, "memory_bytes": 0},
    log_left=0,
)
NODES = (
    Node(id="n1", name="one", resources={"CPU": 4.0, "GPU": 1.0}),
    Node(id="n2", name="two", resources={"CPU": 2.0, "GPU": 4.0}),
)
FREE = {"CPU": 6.0, "GPU": 5.0, "memory": 1e12}


@dataclass
class FakeCluster:
    """Answers as the last look says, and notes the calls."""

    actors: dict[str, Actor] = field(default_factory=dict)
    nodes: tuple[Node, ...] = NODES
    available: dict[str, float] = field(default_factory=lambda: dict(FREE))
    began: float = 0.0
    away: bool = False
    calls: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def look(self) -> Look:
        if self.away:
            raise ExecutorAwayError("the head does not answer")
        began = self.began or time.monotonic()
        return Look(began=began, actors=self.actors, nodes=self.nodes, available=self.available)

    def call(self, op: str, _timeout_s: float = 0.0, **given: Any) -> None:
        if self.away:
            raise ExecutorAwayError("the head does not answer")
        self.calls.append((op, given))

    def hurry(self) -> None:
        pass


def make(tmp_path: Path, **settings: Any) -> tuple[RayExecutor, FakeCluster]:
    """Return an executor on a fake cluster."""
    given = {"ray_address": "10.0.0.1:6379", "data": tmp_path, "executor": "ray", **settings}
    executor, cluster = RayExecutor(Settings(**given), "secret"), FakeCluster()
    executor._cluster = cluster  # type: ignore[assignment]
    return executor, cluster


def launch(**more: Any) -> Launch:
    given = {"job_id": "job_a", "run": 3, "address": "unix:/s", "token": "t", "work_dir": Path("/x")}
    return Launch(**{**given, "servers": ("unix:/s", "tls:10.0.0.9:1", "tls:10.0.0.8:1"), **more})


def test_a_run_is_ordered_with_what_it_needs_and_never_told_of_sockets_of_the_server(tmp_path: Path):
    executor, cluster = make(tmp_path, run_memory_bytes=123, ray_run_cpus=2.5, run_environment=("HF_*",))
    handle = executor.start(launch(num_gpus=4))
    ((op, given),) = cluster.calls
    assert (op, given["name"], given["unfit"]) == ("start", RUN, [])
    order = given["launch"]
    assert order["needs"] == {"cpus": 2.5, "gpus": 4, "memory_bytes": 123}
    assert order["identity"]["address"] == "tls:10.0.0.9:1"
    assert order["identity"]["servers"] == ["tls:10.0.0.9:1", "tls:10.0.0.8:1"]
    assert "HF_*" in order["environment"]
    # The interpreter of the node, not of the server.
    assert order["command"][0] is None
    assert (handle["run"], handle["host"], handle["cluster"]) == (RUN, "", "10.0.0.1:6379")
    assert executor.adopt(handle)
    assert executor.sees(handle)


def test_servers_with_one_secret_share_a_namespace_and_others_have_their_own(tmp_path: Path):
    first, _ = make(tmp_path)
    second, _ = make(tmp_path)
    other = RayExecutor(Settings(ray_address="10.0.0.1:6379", data=tmp_path), "another")
    assert second.adopt(first.start(launch()))
    assert not second.adopt({**HANDLE, "namespace": other._namespace})
    assert not second.adopt({**HANDLE, "cluster": "10.0.0.2:6379"})
    assert not second.adopt({**HANDLE, "executor": "local"})
    with pytest.raises(ExecutorAwayError):
        second.poll({**HANDLE, "executor": "local"})


def test_a_run_is_gone_when_the_cluster_does_not_list_it_but_not_before_it_could(tmp_path: Path):
    executor, cluster = make(tmp_path)
    assert executor.poll(HANDLE) == Gone(None)
    cluster.began = time.monotonic()
    handle = executor.start(launch())
    assert executor.poll(handle) is None
    cluster.began = time.monotonic()
    assert executor.poll(handle) == Gone(None)


def test_nothing_is_known_of_runs_while_the_cluster_is_away(tmp_path: Path):
    executor, cluster = make(tmp_path)
    cluster.away = True
    with pytest.raises(ExecutorAwayError):
        executor.poll(HANDLE)
    assert not executor.sees(HANDLE)
    assert executor.runs() == frozenset()
    assert executor.room([], []).most_gpus() is None
    executor.stop(HANDLE, force=True)
    executor.forget(RUN)


def test_a_node_that_does_not_answer_is_not_taken_for_dead(tmp_path: Path):
    executor, cluster = make(tmp_path, lost_after_s=5.0)
    cluster.actors[RUN] = replace(ACTOR, silent_s=4.9)
    assert executor.poll(HANDLE) is None
    cluster.actors[RUN] = replace(ACTOR, silent_s=5.1)
    with pytest.raises(ExecutorAwayError, match="one does not answer"):
        executor.poll(HANDLE)


def test_the_end_of_a_run_is_told_once_its_output_is_here(tmp_path: Path):
    executor, cluster = make(tmp_path)
    cluster.actors[RUN] = replace(ACTOR, exit_code=7, log_left=10)
    assert executor.poll(HANDLE) is None
    cluster.actors[RUN] = replace(ACTOR, exit_code=7)
    assert executor.poll(HANDLE) == Gone(7)


def test_output_is_appended_where_the_file_ends_and_nowhere_else(tmp_path: Path):
    executor, cluster = make(tmp_path)
    cluster.actors[RUN] = ACTOR
    assert executor._offsets() == {}
    executor.poll(HANDLE)
    assert executor._offsets() == {RUN: 0}

    def piece(offset: int, data: bytes) -> dict[str, Any]:
        return {"offset": offset, "log": base64.b64encode(data).decode()}

    for offset, data in ((0, b"one "), (0, b"one "), (4, b"two"), (9, b"later")):
        executor._take_log(RUN, piece(offset, data))
    assert (tmp_path / "runs" / "job_a" / "run-3.log").read_bytes() == b"one two"
    assert executor._offsets() == {RUN: 7}


def test_a_run_without_a_node_goes_back_after_the_time_of_the_settings(tmp_path: Path):
    executor, cluster = make(tmp_path, ray_place_s=0.1)
    cluster.actors[RUN] = replace(ACTOR, answered=False, node="")
    assert executor.poll(HANDLE) is None
    time.sleep(0.15)
    gone = executor.poll(HANDLE)
    assert gone is not None
    assert "within 0.1 s" in gone.not_placed
    assert cluster.calls == [("forget", {"name": RUN})]


def test_a_node_that_refuses_runs_is_left_out(tmp_path: Path):
    executor, cluster = make(tmp_path)
    cluster.actors[RUN] = replace(ACTOR, node="n2", refused="version 0.0.9 is installed")
    gone = executor.poll(HANDLE)
    assert gone is not None
    assert gone.not_placed == "two: version 0.0.9 is installed"
    cluster.actors.clear()
    assert executor.room([], []).most_gpus() == 1
    executor.start(launch())
    assert cluster.calls[-1][1]["unfit"] == ["n2"]


def test_room_is_what_runs_and_others_leave(tmp_path: Path):
    executor, cluster = make(tmp_path)
    assert executor.room([], []).most_gpus() == 4
    assert (executor.max_gpus(), executor.num_places()) == (4, 6)
    cluster.actors[RUN] = replace(ACTOR, node="n2", needs={"cpus": 1.0, "gpus": 3, "memory_bytes": 0})
    assert executor.room([HANDLE], []).most_gpus() == 1
    waiting = {"run": "job_b/1", "needs": {"cpus": 1.0, "gpus": 1, "memory_bytes": 0}}
    assert executor.room([HANDLE], [waiting]).most_gpus() == 1
    assert executor.room([HANDLE], [waiting, waiting]).most_gpus() == 0
    cluster.available = {"CPU": 0.5}
    assert executor.room([HANDLE], []).most_gpus() is None
    # The largest node may be unavailable.
    cluster.nodes = NODES[:1]
    assert executor.max_gpus() == 4


def test_runs_may_wait_for_nodes_that_do_not_exist_yet(tmp_path: Path):
    executor, cluster = make(tmp_path, ray_ahead=1, ray_node_gpus=8)
    cluster.nodes, cluster.available = (), {}
    assert executor.max_gpus() == 8
    room = executor.room([], [])
    assert (room.most_gpus() or 0) >= 8
    room.take(8)
    assert room.most_gpus() is None
    waiting = {"run": "job_b/1", "needs": {"cpus": 1.0, "gpus": 8, "memory_bytes": 0}}
    assert executor.room([waiting], []).most_gpus() is None


def test_an_actor_that_has_answered_once_is_never_taken_for_one_without_a_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A new process that speaks with Ray has not heard of it yet."""
    executor, cluster = make(tmp_path, ray_place_s=30.0, lost_after_s=60.0)
    needs = {"cpus": 1.0, "gpus": 3, "memory_bytes": 0}
    cluster.actors[RUN] = replace(ACTOR, node="n2", needs=needs)
    assert executor.poll(HANDLE) is None
    cluster.actors[RUN] = replace(ACTOR, answered=False, silent_s=0.0, node="", needs={})
    assert executor.room([HANDLE], []).most_gpus() == 1
    assert executor.poll(HANDLE) is None
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now + 40.0)
    assert executor.poll(HANDLE) is None
    monkeypatch.setattr(time, "monotonic", lambda: now + 70.0)
    with pytest.raises(ExecutorAwayError, match="two does not answer"):
        executor.poll(HANDLE)
    assert cluster.calls == []


def test_a_run_that_has_reported_is_never_said_not_to_have_been_placed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    executor, cluster = make(tmp_path, ray_place_s=30.0)
    cluster.actors[RUN] = replace(ACTOR, answered=False, node="")
    now = time.monotonic()
    for later in (0.0, 40.0):
        monkeypatch.setattr(time, "monotonic", lambda later=later: now + later)
        with pytest.raises(ExecutorAwayError, match="does not answer"):
            executor.poll(HANDLE, has_reported=True)
    assert cluster.calls == []
    cluster.actors[RUN] = replace(ACTOR, refused="unschedulable")
    assert executor.poll(HANDLE, has_reported=True) == Gone(None)
    # The node is not to blame.
    assert executor.room([], []).most_gpus() == 4


def test_a_cluster_that_another_server_calls_by_another_address_is_known_by_its_actors(tmp_path: Path):
    executor, cluster = make(tmp_path)
    handle = {**HANDLE, "cluster": "ray://head.example:10001"}
    assert not executor.adopt(handle)
    with pytest.raises(ExecutorAwayError, match="another cluster"):
        executor.poll(handle)
    cluster.actors[RUN] = ACTOR
    assert executor.adopt(handle)
    assert executor.sees(handle)
    assert executor.poll(handle) is None
    assert not executor.adopt({**handle, "namespace": "of others"})
    assert not executor.adopt({**handle, "executor": "local"})


def test_runs_of_other_executors_take_no_place_of_those_that_may_wait(tmp_path: Path):
    executor, cluster = make(tmp_path, ray_ahead=1)
    cluster.nodes, cluster.available = (), {}
    local = {"executor": "local", "run": "job_b/1", "pid": 1, "gpus": []}
    elsewhere = {**HANDLE, "run": "job_c/1", "cluster": "10.0.0.2:6379"}
    assert executor.room([], [local, elsewhere]).most_gpus() is not None
    assert executor.room([], [local, HANDLE]).most_gpus() is None


def test_the_output_of_a_run_that_ended_unseen_is_fetched_before_its_end_is_told(tmp_path: Path):
    """After a restart, the first look asks for no output: all of it is left."""
    executor, cluster = make(tmp_path)
    assert executor._offsets() == {}
    cluster.actors[RUN] = replace(ACTOR, exit_code=0, log_left=9)
    assert executor.poll(HANDLE) is None
    assert executor._offsets() == {RUN: 0}
    cluster.actors[RUN] = replace(ACTOR, exit_code=0, log_left=0)
    assert executor.poll(HANDLE) == Gone(0)


class _Handler(grpc.GenericRpcHandler):  # type: ignore[misc]
    def __init__(self, status: grpc.StatusCode | None) -> None:
        self._status = status

    def service(self, _details: Any) -> Any:
        def answer(_request: bytes, context: Any) -> bytes:
            if self._status is not None:
                context.abort(self._status, "no")
            return b""

        return grpc.unary_unary_rpc_method_handler(answer)


@pytest.fixture
def head() -> Iterator[Any]:
    """Yield what starts a head that answers in this way, and returns its address."""
    servers = []

    def start(status: grpc.StatusCode | None) -> str:
        server = grpc.server(ThreadPoolExecutor(1), handlers=(_Handler(status),))
        servers.append(server)
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        return f"127.0.0.1:{port}"

    yield start
    for server in servers:
        server.stop(0).wait()


def test_a_cluster_that_obeys_everybody_is_refused_unless_a_setting_allows_it(tmp_path: Path, head: Any):
    closed, open_to_all = head(grpc.StatusCode.UNAUTHENTICATED), head(None)
    assert probe(closed) == probe(f"ray://{closed}") == "closed"
    assert probe(open_to_all) == probe(f"ray://{open_to_all}") == "open"
    assert probe("127.0.0.1:1") == "away"
    given = {"executor": "ray", "data": tmp_path, "worker_address": "127.0.0.1:5"}
    pytest.importorskip("ray")
    with pytest.raises(ServeError, match=r"serve\.ray_without_token.*RAY_AUTH_MODE=token"):
        open_executor(Settings(ray_address=open_to_all, **given), "secret")
    allowed = Settings(ray_address="127.0.0.1:1", ray_without_token=True, **given)
    open_executor(allowed, "secret").close()


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({}, "ray_address_missing"),
        ({"ray_address": "127.0.0.1:1"}, "ray_needs_worker_address"),
        (
            {"ray_address": "127.0.0.1:1", "worker_address": "127.0.0.1:2", "ray_token_file": "/none"},
            "ray_token_missing",
        ),
    ],
)
def test_what_is_missing_is_said_at_the_start(tmp_path: Path, given: dict[str, Any], code: str):
    pytest.importorskip("ray")
    with pytest.raises(ServeError, match=f"serve.{code}"):
        open_executor(Settings(executor="ray", data=tmp_path, **given), "secret")


def test_the_process_that_speaks_with_ray_gets_the_token_and_none_of_our_secrets(tmp_path: Path):
    environment = {"PATH": "/bin", "RAY_TLS_CA_CERT": "x", "LAMBENT_DATABASE": "postgresql://u:p@h/d"}
    given = link_environment(Settings(data=tmp_path, ray_token_file=tmp_path / "token"), environment)
    assert given["RAY_AUTH_MODE"] == "token"
    assert given["RAY_AUTH_TOKEN_PATH"] == str(tmp_path / "token")
    assert given["RAY_TLS_CA_CERT"] == "x"
    assert "LAMBENT_DATABASE" not in given
    assert "RAY_AUTH_MODE" not in link_environment(
        Settings(data=tmp_path, ray_without_token=True), environment
    )


def test_the_hash_of_what_is_installed_is_the_same_twice():
    first = installed()
    assert first == installed()
    assert first["version"]
    assert len(first["digest"]) == 64
