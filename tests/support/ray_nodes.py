"""A Ray cluster of two nodes that a test starts: the second in a network of its own where root may make one.

Only processes that were started here are ended: they carry a mark in their environment, or descend from such.
"""

import contextlib
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

_MARK = "LAMBENT_TEST_RAY"
_STARTED_S = 240.0
# Ray gives a node half a minute, and its agents 15 s, which a machine that is busy otherwise may not have. A
# head does not start, either, while another node of the former cluster lives on the same machine.
_TRIED_S = 180.0
_QUICK = {
    "RAY_health_check_initial_delay_ms": "1000",
    "RAY_health_check_period_ms": "500",
    "RAY_health_check_timeout_ms": "3000",
    "RAY_health_check_failure_threshold": "4",
    "RAY_gcs_rpc_server_reconnect_timeout_s": "30",
    "RAY_worker_register_timeout_seconds": "240",
    "RAY_gcs_server_request_timeout_seconds": "120",
    "RAY_worker_niceness": "0",
    "RAY_USAGE_STATS_ENABLED": "0",
}


def free_port(host: str = "127.0.0.1") -> int:
    """Return a port that nobody uses at present."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


class Network:
    """A second address of this machine: at the other end of a cable (root on Linux), or on the loopback."""

    def __init__(self, number: int) -> None:
        self.name = f"lamray{number}"
        self.first, self.second = f"10.203.{number}.1", f"10.203.{number}.2"
        self.prefix: list[str] = []
        commands = (
            f"ip netns add {self.name}",
            f"ip link add {self.name}a type veth peer name {self.name}b",
            f"ip link set {self.name}b netns {self.name}",
            f"ip addr add {self.first}/30 dev {self.name}a",
            f"ip link set {self.name}a up",
            f"ip netns exec {self.name} ip addr add {self.second}/30 dev {self.name}b",
            f"ip netns exec {self.name} ip link set {self.name}b up",
            f"ip netns exec {self.name} ip link set lo up",
        )
        try:
            for command in commands:
                subprocess.run(command.split(), check=True, capture_output=True)
        except (OSError, subprocess.CalledProcessError):
            self.close()
            self.first, self.second = "127.0.0.1", "127.0.0.2"
            return
        self.prefix = ["ip", "netns", "exec", self.name]

    def close(self) -> None:
        """Remove it."""
        with contextlib.suppress(OSError):
            subprocess.run(["ip", "link", "del", f"{self.name}a"], capture_output=True, check=False)
            subprocess.run(["ip", "netns", "del", self.name], capture_output=True, check=False)

    def cut(self, *, off: bool) -> None:
        """Pull the cable, or plug it in again."""
        assert self.prefix, "there is no cable"
        state = "down" if off else "up"
        subprocess.run(["ip", "link", "set", f"{self.name}a", state], check=True, capture_output=True)


class RayNodes:
    """Starts, kills and restarts the nodes "head" and "second"."""

    def __init__(self, folder: Path, *, redis: str | None = None, token: bool = True) -> None:
        self.folder = folder
        # Sockets have short names.
        self.sessions = Path(f"/tmp/lamray-{secrets.token_hex(4)}")
        self.mark = secrets.token_hex(8)
        self.network = Network(os.getpid() % 200 + 20)
        self.port = free_port(self.network.first)
        self.client_port = free_port(self.network.first)
        self.address = f"{self.network.first}:{self.port}"
        self.client_address = f"ray://{self.network.first}:{self.client_port}"
        self.token_file = folder / "ray-token"
        self.token_file.write_text(secrets.token_hex(32))
        self.token_file.chmod(0o600)
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("RAY_")},
            **_QUICK,
            "RAY_AUTH_MODE": "token" if token else "disabled",
            "RAY_AUTH_TOKEN_PATH": str(self.token_file),
            "OMP_NUM_THREADS": "1",
            "SECRET_OF_THE_NODE": "must not reach runs",
        }
        if redis is not None:
            self.environment |= {
                "RAY_REDIS_ADDRESS": redis,
                "RAY_external_storage_namespace": f"lambent-{self.mark}",
            }

    def start(self, node: str, cpus: int = 2, gpus: int = 0, **environment: str) -> None:
        """Start a node and wait until it has joined."""
        command = [sys.executable, "-m", "ray.scripts.scripts", "start", "--disable-usage-stats"]
        command += [f"--num-cpus={cpus}", f"--num-gpus={gpus}", "--object-store-memory=80000000"]
        command += [f"--memory={4 * 2**30}", "--include-log-monitor=false"]
        if node == "head":
            command += ["--head", f"--port={self.port}", f"--node-ip-address={self.network.first}"]
            command += ["--include-dashboard=false", f"--temp-dir={self.sessions}", "--no-monitor"]
            command += [f"--ray-client-server-port={self.client_port}"]
        else:
            command = [*self.network.prefix, *command]
            command += [f"--address={self.address}", f"--node-ip-address={self.network.second}"]
        given = {**self.environment, _MARK: f"{self.mark}-{node}", **environment}
        log = self.folder / f"ray-{node}.log"
        deadline = time.monotonic() + _TRIED_S
        while time.monotonic() < deadline:
            with log.open("ab") as file, contextlib.suppress(subprocess.TimeoutExpired):
                done = subprocess.run(
                    command, env=given, stdout=file, stderr=file, timeout=_STARTED_S, check=False
                )
                if done.returncode == 0:
                    return
            self.kill(node)
        raise AssertionError(log.read_text()[-3000:])

    def processes(self, node: str = "", name: str = "") -> list[psutil.Process]:
        """Return the processes of a node, or of both; `name` is part of the command, such as "gcs_server"."""
        found: dict[int, psutil.Process] = {}
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error, OSError):
                if process.environ().get(_MARK, "").startswith(f"{self.mark}-{node}"):
                    for each in (process, *process.children(recursive=True)):
                        found[each.pid] = each
        wanted = []
        for process in found.values():
            with contextlib.suppress(psutil.Error):
                if process.status() != psutil.STATUS_ZOMBIE and name in " ".join(process.cmdline()[:1]):
                    wanted.append(process)
        return wanted

    def kill(self, node: str, name: str = "") -> int:
        """Kill processes of a node like a power failure; return how many."""
        victims = self.processes(node, name)
        for process in victims:
            with contextlib.suppress(psutil.Error):
                process.send_signal(signal.SIGSTOP)
        for process in victims:
            with contextlib.suppress(psutil.Error):
                process.kill()
        psutil.wait_procs(victims, timeout=10)
        return len(victims)

    def actors(self) -> list[psutil.Process]:
        """Return the processes of our actors."""
        return self.processes(name="RunHolder")

    def close(self) -> None:
        """End everything."""
        deadline = time.monotonic() + 30
        while self.processes() and time.monotonic() < deadline:
            self.kill("")
        self.network.close()
        shutil.rmtree(self.sessions, ignore_errors=True)


@contextlib.contextmanager
def ray_nodes(folder: Path, *, gpus: int = 0, redis: str | None = None) -> Iterator[RayNodes]:
    """Yield a cluster of two nodes with two processors each; the second one says that it has `gpus`."""
    folder.mkdir(parents=True, exist_ok=True)
    nodes = RayNodes(folder, redis=redis)
    try:
        nodes.start("head")
        nodes.start("second", gpus=gpus)
        yield nodes
    finally:
        nodes.close()
