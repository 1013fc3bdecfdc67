"""A server whose runs are on a Ray cluster of two nodes, which this module starts, and what can die there.

`LAMBENT_CHAOS_RAY_KILLS` is how much is killed at random, `LAMBENT_CHAOS_SEED` in which order. Only
`make chaos` runs this: Ray gives up nodes whose agents start too slowly, as they do beside other tests. A job
on a cluster without faults is in `tests/integration/test_deployed_commands.py`.
"""

import contextlib
import json
import os
import random
import sqlite3
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from lambent_server.storage.store import BlobStore
from sqlalchemy import create_engine
from support.invariants import broken
from support.live_server import LiveServer, wait_until
from support.ray_nodes import RayNodes, free_port, ray_nodes

pytest.importorskip("ray")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(900),
    pytest.mark.skipif("LAMBENT_TEST_RAY" not in os.environ, reason="kills a Ray cluster: make chaos"),
]

KILLS = int(os.environ.get("LAMBENT_CHAOS_RAY_KILLS", "8"))
SEED = int(os.environ.get("LAMBENT_CHAOS_SEED", "0"))
VICTIMS = ("run", "actor", "server", "node", "head")
OFTEN = (10, 10, 4, 2, 1)
"""How often each is killed, among 27."""
ORPHAN_AFTER_S = 4.0
"""Age at which a server that starts removes bytes that nothing names."""
ENDLESS = {"num_steps": 100_000, "step_s": 0.05}


def wait_for(condition: Any) -> Any:
    """Return the first truthy value of `condition()`, with the patience that a busy machine needs."""
    return wait_until(condition, timeout_s=300.0)


def settings_for(nodes: RayNodes, **more: Any) -> dict[str, Any]:
    """Return the settings of a server beside the cluster's head."""
    return {
        "executor": "ray",
        "ray_address": nodes.address,
        "ray_token_file": str(nodes.token_file),
        "ray_poll_s": 0.2,
        "ray_away_s": 20.0,
        "ray_place_s": 240.0,
        "place_retry_s": 0.5,
        "lost_after_s": 10.0,
        "worker_address": f"{nodes.network.first}:{free_port(nodes.network.first)}",
        "stop_grace_s": 20.0,
        # More losses before a checkpoint would be poison, which has its own test.
        "max_losses": 1000,
        "max_losses_without_checkpoint": 1000,
        "orphan_after_s": ORPHAN_AFTER_S,
        **more,
    }


def live(data: Path, nodes: RayNodes, **more: Any) -> LiveServer:
    """Return a server beside the cluster's head; files of runs are in a folder by which it finds them."""
    return LiveServer(data, **settings_for(nodes, ray_folder=f"{data}-nodes", **more))


@pytest.fixture(scope="module")
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RayNodes]:
    with ray_nodes(tmp_path_factory.mktemp("ray"), gpus=2) as nodes:
        yield nodes


@pytest.fixture(scope="module")
def server(nodes: RayNodes, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    folder = tmp_path_factory.mktemp("server")
    with live(folder / "data", nodes) as server:
        yield server


@pytest.fixture(scope="module")
def scene(server: LiveServer) -> str:
    return server.scene()


def node_of(nodes: RayNodes, server: LiveServer, job: str) -> str:
    """Return on which node a job's run is."""
    run = server.supervisor(job)
    return next(name for name in ("head", "second") if run in nodes.processes(name))


def job_of(run: psutil.Process) -> str:
    """Return the job of a run process; "" if it is gone."""
    with contextlib.suppress(psutil.Error):
        return str(json.loads(run.environ()["LAMBENT_RUN"])["job_id"])
    return ""


def running(server: LiveServer, jobs: list[str]) -> list[str]:
    """Return the jobs that have a run that reports."""
    return [job for job in jobs if server.job(job)["state"] == "running" and server.job(job)["progress"]]


def first_steps(server: LiveServer, job: str) -> list[int]:
    """Return the step at which each run of a job began."""
    log = server.client.get(f"/v1/jobs/{job}/log").text
    return [
        int(line.split('"first_step": ')[1].split(",")[0].rstrip("}"))
        for line in log.splitlines()
        if '"first_step": ' in line
    ]


def test_as_many_jobs_run_as_the_nodes_have_processors_for_and_get_no_secrets_of_the_nodes(
    server: LiveServer, nodes: RayNodes, scene: str, end: Path
):
    jobs = [server.submit(scene, **ENDLESS, until=end) for _ in range(5)]
    wait_for(lambda: len(running(server, jobs)) == 4)
    first = running(server, jobs)
    assert sorted(node_of(nodes, server, job) for job in first) == ["head", "head", "second", "second"]
    environment = server.supervisor(first[0]).environ()
    assert not [name for name in environment if name.startswith("RAY_") or "SECRET" in name]
    assert nodes.token_file.read_text() not in str(environment)
    assert "tls:" in json.loads(environment["LAMBENT_RUN"])["address"]
    time.sleep(1.0)
    assert sum(server.job(job)["state"] == "queued" for job in jobs) == 1
    end.touch()
    found = [server.wait(job) for job in jobs]
    assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 5
    assert "sleep.started" in server.client.get(f"/v1/jobs/{jobs[0]}/log").text
    wait_for(lambda: not nodes.actors())
    assert not list(Path(f"{server.data}-nodes").glob("*/job_*"))


def test_a_killed_actor_takes_its_run_along_and_the_next_run_goes_on_from_the_checkpoint(
    server: LiveServer, nodes: RayNodes, scene: str, tmp_path: Path, end: Path
):
    ends = tmp_path / "ends"
    job = server.submit(scene, **ENDLESS, until=end, touch=ends)
    server.wait_step(job, 12)
    run = server.supervisor(job)
    family = [run, *run.children(recursive=True)]
    run.parent().kill()
    _, alive = psutil.wait_procs(family, timeout=10)
    assert not alive
    end.touch()
    found = server.wait(job)
    assert (found["state"], found["run"], found["error"]) == ("succeeded", 2, None)
    assert first_steps(server, job)[1] >= 5
    assert ends.read_text().count("\n") == 1


def test_a_cancelled_run_writes_a_checkpoint_and_ends(
    server: LiveServer, nodes: RayNodes, scene: str, end: Path
):
    job = server.submit(scene, **ENDLESS, until=end, checkpoint_every=100_000)
    server.wait_step(job, 3)
    server.client.post(f"/v1/jobs/{job}:cancel").raise_for_status()
    assert server.wait(job)["state"] == "cancelled"
    assert any(event["type"] == "checkpoint" for event in server.events(job))
    wait_for(lambda: not nodes.actors())


def test_a_run_that_does_not_end_when_asked_is_killed(server: LiveServer, nodes: RayNodes, scene: str):
    job = server.submit(scene, num_steps=10, hang_at=3)
    server.wait_step(job, 2)
    server.client.post(f"/v1/jobs/{job}:cancel").raise_for_status()
    assert server.wait(job)["state"] == "cancelled"
    assert not server.run_processes()


def test_a_run_that_crashes_counts_as_failed_and_its_output_is_there(server: LiveServer, scene: str):
    job = server.submit(scene, num_steps=10, fail_at=3, checkpoint_every=100)
    found = server.wait(job)
    assert (found["state"], found["run"], found["error"]["code"]) == ("failed", 3, "run.crashed")
    assert server.client.get(f"/v1/jobs/{job}/log").text.count("the test asked for it") >= 3


def test_a_job_gets_the_gpus_of_one_node_and_not_more_than_one_node_has(
    server: LiveServer, nodes: RayNodes, scene: str, end: Path
):
    assert server.client.get("/v1/limits").json()["max_gpus"] == 2
    order = {"scene_id": scene, "preset": "tiny", "params": {"until": str(end), "num_steps": "100000"}}
    refused = server.client.post("/v1/jobs", json={**order, "gpus": 3})
    assert (refused.status_code, refused.json()["code"]) == (422, "unsatisfiable_resources")
    jobs = [server.client.post("/v1/jobs", json={**order, "gpus": gpus}).json()["id"] for gpus in (2, 1)]
    environment = server.supervisor(jobs[0]).environ()
    assert environment["CUDA_VISIBLE_DEVICES"] == "0,1"
    assert node_of(nodes, server, jobs[0]) == "second"
    time.sleep(1.0)
    assert server.job(jobs[1])["state"] == "queued"
    end.touch()
    assert [server.wait(job)["state"] for job in jobs] == ["succeeded"] * 2


def test_a_killed_server_finds_its_runs_again_by_name_and_none_is_restarted(
    server: LiveServer, nodes: RayNodes, scene: str, end: Path
):
    jobs = [server.submit(scene, **ENDLESS, until=end) for _ in range(3)]
    wait_for(lambda: len(running(server, jobs)) == 3)
    server.kill()
    time.sleep(2.0)
    server.start()
    steps = {job: server.job(job)["progress"]["step"] for job in jobs}
    for job in jobs:
        server.wait_step(job, steps[job] + 20)
    end.touch()
    found = [server.wait(job) for job in jobs]
    assert [(job["state"], job["run"]) for job in found] == [("succeeded", 1)] * 3
    # Whole, although one server began it and another continued.
    for job in jobs:
        assert first_steps(server, job) == [0]
    wait_for(lambda: not nodes.actors())


def test_actors_that_no_job_wants_are_ended(server: LiveServer, nodes: RayNodes, scene: str, end: Path):
    job = server.submit(scene, **ENDLESS, until=end)
    server.wait_step(job, 2)
    server.kill()
    with sqlite3.connect(server.data / "lambent.sqlite", timeout=10) as database:
        database.execute("UPDATE jobs SET handle = NULL, state = 'failed' WHERE id = ?", (job,))
    database.close()
    assert nodes.actors()
    server.start()
    wait_for(lambda: not nodes.actors() and not server.run_processes())


def test_a_lost_node_costs_its_own_runs_one_checkpoint_interval_and_the_others_nothing(
    server: LiveServer, nodes: RayNodes, scene: str, tmp_path: Path, end: Path
):
    ends = tmp_path / "ends"
    jobs = [server.submit(scene, **ENDLESS, until=end, touch=ends) for _ in range(4)]
    wait_for(lambda: len(running(server, jobs)) == 4)
    places = {job: node_of(nodes, server, job) for job in jobs}
    for job in jobs:
        server.wait_step(job, 12)
    nodes.kill("second", "raylet")
    lost = [job for job in jobs if places[job] == "second"]
    kept = [job for job in jobs if places[job] == "head"]
    wait_for(lambda: all(server.job(job)["state"] == "queued" for job in lost))
    # Nothing of them is left on the node that Ray gave up.
    wait_for(lambda: not [job for job in map(job_of, server.run_processes()) if job in lost])
    nodes.kill("second")
    nodes.start("second", gpus=2)
    wait_for(lambda: all(server.job(job)["run"] == 2 for job in lost))
    end.touch()
    found = {job: server.wait(job) for job in jobs}
    assert {job["state"] for job in found.values()} == {"succeeded"}
    assert [found[job]["run"] for job in kept] == [1, 1]
    assert all(first_steps(server, job)[-1] >= 5 for job in lost)
    assert ends.read_text().count("\n") == 4


def test_jobs_survive_a_head_that_is_killed_and_forgets_everything(
    server: LiveServer, nodes: RayNodes, scene: str, tmp_path: Path, end: Path
):
    ends = tmp_path / "ends"
    jobs = [server.submit(scene, **ENDLESS, until=end, touch=ends) for _ in range(4)]
    wait_for(lambda: len(running(server, jobs)) == 4)
    for job in jobs:
        server.wait_step(job, 6)
    nodes.kill("head")
    time.sleep(1.0)
    nodes.start("head")
    wait_for(lambda: server.job(jobs[0])["state"] in ("running", "queued"))
    nodes.kill("second")
    nodes.start("second", gpus=2)
    end.touch()
    found = [server.wait(job) for job in jobs]
    assert [job["state"] for job in found] == ["succeeded"] * 4
    assert ends.read_text().count("\n") == 4
    wait_for(lambda: not nodes.actors() and not server.run_processes())


def test_a_server_that_is_no_node_of_the_cluster_uses_the_client_protocol(
    nodes: RayNodes, tmp_path: Path, end: Path
):
    with live(tmp_path / "data", nodes, ray_address=nodes.client_address) as server:
        job = server.submit(server.scene(), **ENDLESS, until=end)
        server.wait_step(job, 5)
        server.kill()
        server.start()
        server.wait_step(job, server.job(job)["progress"]["step"] + 20)
        end.touch()
        found = server.wait(job)
        assert (found["state"], found["run"]) == ("succeeded", 1)
        assert first_steps(server, job) == [0]
        wait_for(lambda: not nodes.actors())


def kill(what: str, server: LiveServer, nodes: RayNodes, choice: random.Random) -> bool:
    """Kill something of a kind, and start again what does not by itself; return False if there is none."""
    if what in ("run", "actor"):
        found = nodes.actors() if what == "actor" else server.run_processes()
        if not found:
            return False
        with contextlib.suppress(psutil.Error):
            choice.choice(found).kill()
    elif what == "server":
        server.kill()
        server.start()
    elif what == "node":
        # First what keeps its actors, and then the rest.
        nodes.kill("second", "raylet")
        nodes.kill("second")
        nodes.start("second", gpus=2)
    else:
        nodes.kill("head")
        nodes.start("head")
        # Without Redis it has forgotten the other node, which notices by itself, some time.
        nodes.kill("second")
        nodes.start("second", gpus=2)
    return True


def wrong_in(server: LiveServer, jobs: list[str]) -> list[str]:
    """Return the promises that do not hold."""
    engine = create_engine(f"sqlite:///{server.data}/lambent.sqlite")
    with engine.connect() as connection:
        found = broken(connection, BlobStore(server.data / "store"), jobs)
    engine.dispose()
    return found


@pytest.mark.timeout(900 + 30 * KILLS)
def test_no_job_is_lost_and_no_effect_doubled_whatever_is_killed(
    server: LiveServer, nodes: RayNodes, scene: str, tmp_path: Path, end: Path
):
    ends = tmp_path / "ends"
    choice = random.Random(SEED)  # noqa: S311
    jobs = [server.submit(scene, **ENDLESS, until=end, touch=ends) for _ in range(6)]
    killed = Counter[str]()
    while killed.total() < KILLS:
        time.sleep(choice.uniform(0.2, 3.0))
        what = choice.choices(VICTIMS, OFTEN)[0]
        if not kill(what, server, nodes, choice):
            continue
        killed[what] += 1
        if killed.total() % 20 == 0:
            print(f"{killed.total()} kills {dict(killed)}", flush=True)
    end.touch()
    found = [server.wait(job, timeout_s=300.0) for job in jobs]
    assert [job["state"] for job in found] == ["succeeded"] * len(jobs)
    wait_for(lambda: not nodes.actors() and not server.run_processes())
    orphans = list(Path(f"{server.data}-nodes").glob("*/job_*"))
    # What was in transit when a server was killed is removed by the next one, once it is old enough.
    time.sleep(ORPHAN_AFTER_S)
    server.end()
    server.start()
    with contextlib.suppress(AssertionError):  # What remains is named below.
        wait_until(lambda: not wrong_in(server, jobs), timeout_s=60.0)
    wrong = wrong_in(server, jobs)
    runs = sum(job["run"] for job in found)
    print(f"\n{killed.total()} kills {dict(killed)}, {len(jobs)} jobs in {runs} runs, {len(wrong)} faults")
    assert not wrong
    assert ends.read_text().count("\n") == len(jobs)
    assert runs > len(jobs), "no kill was noticed"
    # Folders of killed actors stay for an hour, in which no other actor removes them.
    assert len(orphans) <= killed.total()
