"""Servers of docker-compose.yml, the Helm chart and the systemd unit as processes of this machine.

Replaced is what there is in containers and clusters only: addresses, folders, the name of the program. Short
intervals, and jobs that sleep, keep tests short.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx2
import psutil
from support.deployed import ROOT, Command
from support.live_server import FAST, SLEEP_TRAINER, LiveServer
from support.s3_server import ACCESS_KEY, SECRET_KEY, S3Server

BUCKET = "lambent"
S3_ADDRESSES = ("http://s3:8333", "https://s3.example.com")
QUICK = {
    **FAST,
    "server_beat_s": 0.3,
    "server_lost_after_s": 3.0,
    "log_copy_s": 0.5,
    "ray_poll_s": 0.2,
    "place_retry_s": 0.5,
}
# What the files decide, and tests must not.
DECIDED = {"port", "local_slots"}
MARK = "LAMBENT_TEST_DEPLOYED"


def free_port() -> int:
    """Return an unused port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Server:
    """A server of one of the files."""

    name: str
    command: Command
    port: int
    folder: Path
    process: subprocess.Popen[bytes]

    @property
    def url(self) -> str:
        """Return its address."""
        return f"http://127.0.0.1:{self.port}"

    def answers(self) -> bool:
        """Return whether it is alive; AssertionError with its log if it has ended."""
        assert self.process.poll() is None, f"{self.name}: {(self.folder / 'log').read_text()[-3000:]}"
        with contextlib.suppress(httpx2.TransportError):
            return httpx2.get(f"{self.url}/healthz", timeout=5).status_code == 200
        return False

    def end(self) -> int:
        """Stop it as its file says, and return the exit code."""
        self.process.send_signal(getattr(signal, self.command.stop_signal))
        return self.process.wait(timeout=60)


class World:
    """A database, an S3 server, the secrets, and the servers that were started."""

    def __init__(self, folder: Path, database: str, s3: S3Server | None = None) -> None:
        self.folder = folder
        self.database = database
        self.s3 = s3
        self.secrets = folder / "secrets"
        self.servers: dict[str, Server] = {}
        environment = {**os.environ, "SECRETS": str(self.secrets)}
        subprocess.run([str(ROOT / "deploy" / "compose" / "secrets.sh")], env=environment, check=True)
        # The S3 server of the tests has its own keys.
        text = f"[default]\naws_access_key_id = {ACCESS_KEY}\naws_secret_access_key = {SECRET_KEY}\n"
        for name in ("s3_credentials", "s3-credentials"):
            (self.secrets / name).unlink(missing_ok=True)
            (self.secrets / name).write_text(text)
        for name in ("database/password", "oidc/client-secret"):
            (self.secrets / name).parent.mkdir()
            (self.secrets / name).write_text("word")
        (self.secrets / "database-password").write_text("word")

    def translated(self, command: Command, port: int, link: int, data: Path, *addresses: str) -> Command:
        """Return a command for this machine; `addresses` are those of its database."""
        return command.replaced(
            {
                **dict.fromkeys(addresses, self.database),
                "/run/secrets": str(self.secrets),
                "/etc/lambent": str(self.secrets),
                "/data": str(data),
                "/var/lib/lambent": str(data),
                "/var/cache/lambent": str(self.folder / "cache"),
                **({} if self.s3 is None else dict.fromkeys(S3_ADDRESSES, self.s3.url)),
                "file:///store": f"file://{self.folder}/store",
                "s3://captures/lambent": f"s3://{BUCKET}/files",
                "server:8421": f"127.0.0.1:{link}",
                "controller:8421": f"127.0.0.1:{link}",
                "10.0.0.7:8421": f"127.0.0.1:{link}",
                "127.0.0.1:8421": f"127.0.0.1:{link}",
                "0.0.0.0:8421": f"127.0.0.1:{link}",
                "0.0.0.0": "127.0.0.1",
                "8420": str(port),
            }
        )

    def environment(self, command: Command) -> dict[str, str]:
        """Return the environment of a process: the file's, with short intervals and jobs that sleep."""
        given = {
            f"LAMBENT_{name.upper()}": value if isinstance(value, str) else json.dumps(value)
            for name, value in QUICK.items()
            if name not in DECIDED
        }
        given["LAMBENT_RUN_COMMAND"] = json.dumps([sys.executable, str(SLEEP_TRAINER), "run"])
        kept = {
            name: value for name, value in os.environ.items() if not name.startswith(("LAMBENT_", "AWS_"))
        }
        values = {"accessKeyId": ACCESS_KEY, "secretAccessKey": SECRET_KEY}
        secrets = {name: values[key] for name, key in command.secrets.items()}
        return {**kept, "AWS_EC2_METADATA_DISABLED": "true", **given, **command.environment, **secrets}

    def start(self, name: str, command: Command, *addresses: str, **more: str) -> Server:
        """Start a server; `more` are texts that are replaced besides."""
        port, link, folder = free_port(), free_port(), self.folder / name
        folder.mkdir()
        command = self.translated(command.replaced(more), port, link, folder / "data", *addresses)
        program, *words = command.words
        assert Path(program).name == "lambent"
        environment = self.environment(command)
        # The unit leaves the port as it is.
        if "--port" not in words:
            environment["LAMBENT_PORT"] = str(port)
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "lambent", *words], env=environment, stdout=log, stderr=log
            )
        server = Server(name, command, port, folder, process)
        self.servers[name] = server
        return server

    def close(self) -> None:
        """Kill what is left."""
        for server in self.servers.values():
            if server.process.poll() is None:
                server.process.kill()
                server.process.wait()
            # Runs that are still there.
            LiveServer(server.folder / "data").__exit__()


@contextlib.contextmanager
def client(world: World, name: str) -> Iterator[LiveServer]:
    """Yield a client of a server of ours."""
    found = LiveServer(world.folder / name / "data")
    found.url = world.servers[name].url
    found.key = next(iter(world.folder.glob("*/data/api.key"))).read_text().strip()
    found.client.close()
    headers = {"Authorization": f"Bearer {found.key}"}
    with httpx2.Client(base_url=found.url, headers=headers, timeout=60.0, verify=False) as found.client:
        yield found


def end_marked(mark: str) -> None:
    """Kill the processes whose environment has this mark, and what they have started."""
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            if process.environ().get(MARK) == mark:
                for each in (*process.children(recursive=True), process):
                    with contextlib.suppress(psutil.Error):
                        each.kill()
