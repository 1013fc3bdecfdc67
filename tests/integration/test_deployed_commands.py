"""Every server of docker-compose.yml, the Helm chart and the systemd unit as plain processes on one database.

Commands and environment are those of the files. Replaced is what there is in containers and clusters only:
addresses, folders, the name of the program. Jobs sleep, and short intervals keep the test short.
"""

import contextlib
import importlib.util
import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from support.databases import postgresql
from support.deployed import (
    ROOT,
    compose,
    compose_command,
    container_command,
    read_env_file,
    rendered,
    unit_command,
)
from support.deployed_servers import BUCKET, MARK, Server, World, client, end_marked, free_port
from support.live_server import LiveServer, wait_until
from support.s3_server import S3Server

pytestmark = [pytest.mark.services, pytest.mark.slow, pytest.mark.long, pytest.mark.timeout(600)]

S3_ENV = ROOT / "deploy" / "compose" / "s3.env"
RAY_ENV = ROOT / "deploy" / "compose" / "ray.env"
# On a busy machine Ray's own patience is too short.
PATIENT = {"RAY_worker_register_timeout_seconds": "240", "RAY_gcs_server_request_timeout_seconds": "120"}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    folder = tmp_path_factory.mktemp("deployed")
    with postgresql() as database, S3Server(folder / "s3") as s3:
        world = World(folder, database, s3)
        try:
            yield world
        finally:
            world.close()


def probe(container: dict[str, Any], kind: str, server: Server) -> int:
    """Return the status that the kubelet would see, which asks a pod by its address."""
    get = container[kind]["httpGet"]
    headers = {each["name"]: each["value"] for each in get["httpHeaders"]}
    return int(httpx2.get(f"{server.url}{get['path']}", headers=headers, timeout=10).status_code)


def test_jobs_run_through_all_services_of_all_files(world: World):
    given = read_env_file(S3_ENV)
    bucket = world.translated(compose_command("s3-bucket", given), 0, 0, world.folder)
    words = [word.replace("/usr/local/share/lambent", str(ROOT / "deploy/compose")) for word in bucket.words]
    for said in ("was created", "is there"):
        done = subprocess.run(
            [sys.executable, *words[1:]],
            env=world.environment(bucket),
            check=True,
            capture_output=True,
            text=True,
        )
        assert said in done.stdout

    of_compose = "postgresql://lambent@postgres:5432/lambent"
    of_chart = "postgresql://lambent@pgbouncer.databases.svc:6432/lambent?sslmode=require"
    direct = "postgresql://lambent@postgres.databases.svc:5432/lambent?sslmode=require"
    of_unit = "postgresql://lambent@db.example:5432/lambent?sslmode=require"
    # The first server on a database writes the key for programs; Compose waits until it answers.
    first = world.start("server", compose_command("server", given), of_compose)
    wait_until(first.answers, timeout_s=120)
    for name in ("controller", "worker-cpu"):
        world.start(name, compose_command(name, given), of_compose)
    containers = {}
    for pod in rendered("s3-oidc"):
        if pod["kind"] == "Deployment":
            (container,) = pod["spec"]["template"]["spec"]["containers"]
            server = world.start(
                f"pod-{pod['metadata']['name']}", container_command(container), of_chart, direct
            )
            containers[server.name] = container
    world.start("unit", unit_command("lambent-server.service", commented=True), of_unit)
    for server in world.servers.values():
        wait_until(server.answers, timeout_s=180)
    assert not (world.folder / "controller" / "data" / "api.key").exists()

    for name in ("server", "controller", "worker-cpu"):
        check = compose()["services"][name]["healthcheck"]["test"][1:]
        check = [part.replace("8420", str(world.servers[name].port)) for part in check]
        subprocess.run([sys.executable, *check[1:]], check=True)
    for name, container in containers.items():
        for kind in {"startupProbe", "livenessProbe", "readinessProbe"} & set(container):
            assert probe(container, kind, world.servers[name]) == 200, (name, kind)
        # Without the header of the probe: nobody may call a server by a name that it does not know.
        strange = httpx2.get(f"{world.servers[name].url}/readyz", headers={"Host": "10.9.9.9"}, timeout=20)
        assert strange.json()["code"] == "host_not_allowed"

    runners = {"worker-cpu", "pod-lambent-worker-cpu", "pod-lambent-worker-gpu", "unit"}
    assert set(world.servers) == {"server", "controller", "pod-lambent-server", *runners}
    end = world.folder / "end"
    with client(world, "server") as front:
        scene = front.scene()
        # As many as there are slots (one of each runner, two of the one with GPUs), all at once.
        jobs = [front.submit(scene, num_steps=100_000, step_s=0.05, until=end) for _ in range(5)]
        for job in jobs:
            front.wait_step(job, 1)
    runs = [path for job in jobs for path in world.folder.glob(f"*/data/runs/{job}")]
    homes = [path.relative_to(world.folder).parts[0] for path in runs]
    assert sorted(homes) == sorted([*runners, "pod-lambent-worker-gpu"])

    # The first server dies. No job is lost, and every other server answers in its place.
    world.servers["server"].process.kill()
    world.servers["server"].process.wait()
    with client(world, "controller") as other:
        assert {other.job(job)["state"] for job in jobs} == {"running"}
        # A worker stops as its container does: its run writes a checkpoint; the job continues elsewhere.
        assert world.servers["worker-cpu"].end() == 0
        moved = next(job for job in jobs if (world.folder / "worker-cpu/data/runs" / job).exists())
        later = other.submit(scene, num_steps=3)
        end.touch()
        found = {job: other.wait(job) for job in (*jobs, later)}
        assert {job["state"] for job in found.values()} == {"succeeded"}
        ran = {name: job["run"] for name, job in found.items()}
        assert ran == {**dict.fromkeys(found, 1), moved: 2}
        manifest = other.client.get(f"/v1/bundles/{found[moved]['bundle_id']}/manifest")
        assert manifest.json()["name"] == "sleep"
    assert world.s3 is not None
    assert any(key.startswith("files/blobs/") for key in world.s3.keys(BUCKET))

    listed = subprocess.run(
        [sys.executable, "-m", "lambent", "admin", "servers", "--json"],
        env=world.environment(world.servers["controller"].command),
        capture_output=True,
        text=True,
        check=True,
    )
    alive = [each for each in map(json.loads, listed.stdout.splitlines()) if each["is_alive"]]
    assert len(alive) >= 5
    for name, server in world.servers.items():
        if server.process.poll() is None:
            assert server.end() == 0, name


def start_ray(name: str, folder: Path, mark: str, replacements: dict[str, str]) -> subprocess.Popen[bytes]:
    """Start a service of Ray in docker-compose.yml, whose processes carry a mark."""
    command = compose_command(name, read_env_file(RAY_ENV)).replaced(replacements)
    assert command.words[0] == "ray"
    others = {key: value for key, value in os.environ.items() if not key.startswith("RAY_")}
    environment = {**others, **PATIENT, **command.environment, MARK: mark}
    words = [sys.executable, "-m", "ray.scripts.scripts", *command.words[1:], "--node-ip-address=127.0.0.1"]
    # A container has processors and memory of its own; here they are those of the tests.
    words.append("--object-store-memory=80000000")
    # Sockets have short names.
    words.append(f"--temp-dir={folder}" if "--head" in words else "--num-cpus=2")
    with folder.with_suffix(f".{name}.log").open("ab") as log:
        return subprocess.Popen(words, env=environment, stdout=log, stderr=log)


def healthy_ray(name: str, folder: Path, mark: str, replacements: dict[str, str]) -> subprocess.Popen[bytes]:
    """Return a service of Ray once it is healthy; one that ends is started again, as Compose does."""
    process = start_ray(name, folder, mark, replacements)

    def is_well() -> bool:
        nonlocal process
        if process.poll() is not None:
            # Ray gives a node that starts half a minute, which is not enough on a machine that is busy.
            process = start_ray(name, folder, mark, replacements)
        return is_healthy(name, replacements)

    wait_until(is_well, timeout_s=240)
    return process


def is_healthy(service: str, replacements: dict[str, str]) -> bool:
    """Return whether the health check of a service of Compose says so."""
    check = compose()["services"][service]["healthcheck"]["test"][1:]
    for old, new in replacements.items():
        check = [part.replace(old, new) for part in check]
    return subprocess.run([sys.executable, *check[1:]], capture_output=True, check=False).returncode == 0


@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="Ray is not installed")
def test_jobs_run_on_the_ray_cluster_of_compose(tmp_path: Path):
    sessions, mark = Path(f"/tmp/lamray-{secrets.token_hex(4)}"), secrets.token_hex(8)
    gcs, client_port, raylet = (str(free_port()) for _ in range(3))
    with postgresql() as database:
        world = World(tmp_path, database)
        # The image has it.
        (tmp_path / "store").mkdir()
        replaced = {
            "ray-head:6379": f"127.0.0.1:{gcs}",
            "6379": gcs,
            "10001": client_port,
            "6380": raylet,
            "/run/secrets": str(world.secrets),
        }
        try:
            nodes = [healthy_ray(name, sessions, mark, replaced) for name in ("ray-head", "ray-node")]
            server = world.start(
                "server",
                compose_command("server", read_env_file(RAY_ENV)),
                "postgresql://lambent@postgres:5432/lambent",
                **{"ray-head:10001": f"127.0.0.1:{client_port}"},
            )
            wait_until(server.answers, timeout_s=180)
            with client(world, "server") as front:
                job = front.submit(front.scene(), num_steps=5)
                assert front.wait(job, timeout_s=240)["state"] == "succeeded"
            # It was not on the server, which has no slots of its own.
            assert server.command.environment["LAMBENT_LOCAL_SLOTS"] == "0"
            assert server.end() == 0
            for node in reversed(nodes):
                node.terminate()
                node.wait(timeout=60)
        finally:
            world.close()
            end_marked(mark)
            shutil.rmtree(sessions, ignore_errors=True)
            for log in sessions.parent.glob(f"{sessions.name}.*.log"):
                log.replace(tmp_path / log.name)


@pytest.mark.skipif(shutil.which("nginx") is None, reason="there is no nginx here")
def test_servers_answer_behind_our_configuration_of_nginx(tmp_path: Path):
    with (
        LiveServer(tmp_path / "a", allowed_hosts="lambent.example", trusted_proxies="127.0.0.1") as server,
        socket.socket() as closed,
    ):
        closed.bind(("127.0.0.1", 0))
        port = free_port()
        text = (ROOT / "deploy" / "proxy" / "nginx.conf").read_text(encoding="utf-8")
        for old, new in {
            "10.0.0.7:8420": server.url.removeprefix("http://"),
            # A server that is gone.
            "10.0.0.8:8420": f"127.0.0.1:{closed.getsockname()[1]}",
            "443 ssl": f"127.0.0.1:{port}",
        }.items():
            assert old in text
            text = text.replace(old, new)
        text = "".join(line for line in text.splitlines(keepends=True) if "ssl_certificate" not in line)
        paths = "".join(
            f"{kind}_temp_path {tmp_path}/{kind}; "
            for kind in ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
        )
        main = tmp_path / "nginx.conf"
        main.write_text(
            f"daemon off; user root; pid {tmp_path}/pid; error_log {tmp_path}/errors;"
            f"events {{}} http {{ access_log off; {paths} {text} }}"
        )
        nginx = subprocess.Popen(["nginx", "-p", str(tmp_path), "-c", str(main)], stderr=subprocess.DEVNULL)
        try:
            headers = {"Host": "lambent.example", "Authorization": f"Bearer {server.key}"}
            base = f"http://127.0.0.1:{port}"

            def get(path: str, **more: Any) -> httpx2.Response:
                return httpx2.get(f"{base}{path}", headers={**headers, **more}, timeout=20)

            def is_up() -> bool:
                with contextlib.suppress(httpx2.TransportError):
                    return get("/healthz").status_code == 200
                return False

            wait_until(is_up, timeout_s=20)
            # Every request arrives, although one of two servers is gone.
            assert {get("/v1/jobs").status_code for _ in range(10)} == {200}
            assert get("/metrics").status_code == 404
            # The snapshot of a job that nothing happens to: sent as it is written, not once a buffer is full.
            job = server.submit(server.scene(), num_steps=1)
            server.wait(job)
            with httpx2.stream("GET", f"{base}/v1/events?job={job}", headers=headers, timeout=30) as stream:
                assert any(line.startswith("data: ") for line in stream.iter_lines())
        finally:
            nginx.terminate()
            nginx.wait(timeout=20)
