"""The server's view of a Ray cluster, through a process that is started again when lost."""

import contextlib
import itertools
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Literal

import structlog

from lambent_server.core.settings import Settings
from lambent_server.executors import ExecutorAwayError

log = structlog.get_logger()

CALL_TIMEOUT_S = 15.0
"""Longest answer of the process; Ray's own calls wait for its head."""
OPEN_TIMEOUT_S = 60.0
PROBE_TIMEOUT_S = 5.0
LOG_BYTES = 1024 * 1024
"""A log of that size, of what Ray says, is put aside in place of the one before it."""
_LONGEST_WAIT_S = 10.0
_ENDED = "the process that speaks with Ray has ended"
_Access = Literal["open", "closed", "away"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Actor:
    """A run's actor, as it said last."""

    answered: bool
    """Whether it has ever answered: it has a node then."""
    silent_s: float
    node: str
    exit_code: int | None
    refused: str
    needs: Mapping[str, Any]
    log_left: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Node:
    """A machine of the cluster and what Ray counts there."""

    id: str
    name: str
    resources: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Look:
    """The cluster at one moment."""

    began: float
    """Monotonic time before the first request."""
    actors: Mapping[str, Actor] = field(default_factory=dict)
    nodes: tuple[Node, ...] = ()
    available: Mapping[str, float] = field(default_factory=dict)


def probe(address: str, timeout_s: float = PROBE_TIMEOUT_S) -> _Access:
    """Return whether a cluster answers those who have no token."""
    import grpc

    host = address.removeprefix("ray://")
    method = "RayletDriver/ClusterInfo" if host != address else "NodeInfoGcsService/GetClusterId"
    with grpc.insecure_channel(host, options=(("grpc.enable_http_proxy", 0),)) as channel:
        call = channel.unary_unary(f"/ray.rpc.{method}", lambda request: request, lambda reply: reply)
        try:
            call(b"", timeout=timeout_s)
        except grpc.RpcError as error:
            return "closed" if error.code() == grpc.StatusCode.UNAUTHENTICATED else "away"
    return "open"


def link_environment(settings: Settings, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of the process that speaks with Ray."""
    kept = ("PATH", "HOME", "LANG", "TMPDIR", "PYTHONPATH", "VIRTUAL_ENV", "LD_LIBRARY_PATH")
    passed = {name: value for name, value in environment.items() if name in kept or name.startswith("RAY_")}
    passed |= {"RAY_USAGE_STATS_ENABLED": "0"}
    if not settings.ray_without_token:
        passed["RAY_AUTH_MODE"] = "token"
    if settings.ray_token_file is not None:
        passed["RAY_AUTH_TOKEN_PATH"] = str(settings.ray_token_file)
    return passed


def _log_of_link(path: Path) -> IO[bytes]:
    """Return the log, to be continued: what the process before said is why there is a new one."""
    if path.exists() and path.stat().st_size > LOG_BYTES:
        path.replace(path.with_suffix(".log.1"))
    return path.open("ab")


class RayProcess:
    """The process that speaks with Ray. One call at a time; safe to use from several threads."""

    def __init__(self, settings: Settings, namespace: str) -> None:
        self._lock = threading.Lock()
        assert settings.ray_address is not None
        command = [
            sys.executable,
            "-P",
            "-m",
            "lambent_server.executors.ray_link",
            settings.ray_address,
            namespace,
        ]
        with _log_of_link(settings.data / "ray-link.log") as file:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=file,
                env=link_environment(settings, os.environ),
                start_new_session=True,
            )
        self._numbers = itertools.count(1)
        self._waiting: dict[int, Future[dict[str, Any]]] = {}
        """The calls that wait for an answer."""
        threading.Thread(target=self._read, args=(self._process.stdout,), daemon=True).start()

    def _read(self, answers: IO[bytes]) -> None:
        with answers:
            for line in answers:
                answer = json.loads(line)
                if (call := self._waiting.pop(answer["id"], None)) is not None:
                    call.set_result(answer)
        # Whoever could still write its request did so before the process ended, and so is among these.
        for number in list(self._waiting):
            if (call := self._waiting.pop(number, None)) is not None:
                call.set_exception(ExecutorAwayError(f"{_ENDED}; see ray-link.log"))

    def call(self, op: str, timeout_s: float = CALL_TIMEOUT_S, **given: Any) -> Any:
        """Return the answer of the process; raises ExecutorAwayError if there is none, or an error."""
        call: Future[dict[str, Any]] = Future()
        number = next(self._numbers)
        self._waiting[number] = call
        request = json.dumps({"id": number, "op": op, "given": given}) + "\n"
        try:
            with self._lock:
                assert self._process.stdin is not None
                self._process.stdin.write(request.encode())
                self._process.stdin.flush()
            answer = call.result(timeout_s)
        except TimeoutError as error:
            raise ExecutorAwayError(f"no answer from Ray within {timeout_s:g} s") from error
        except OSError as error:
            raise ExecutorAwayError(_ENDED) from error
        finally:
            self._waiting.pop(number, None)
        if "error" in answer:
            raise ExecutorAwayError(answer["error"])
        return answer["result"]

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()
        with contextlib.suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()


class Cluster:
    """Looks at the cluster again and again, in a thread of its own."""

    def __init__(
        self,
        settings: Settings,
        namespace: str,
        offsets: Callable[[], dict[str, int]],
        take: Callable[[str, dict[str, Any]], None],
    ) -> None:
        """Prepare; `offsets` returns the runs whose output is wanted and from where, `take` gets pieces."""
        self._settings = settings
        self._namespace = namespace
        self._offsets = offsets
        self._take = take
        self._link: RayProcess | None = None
        self._look: Look | None = None
        self._stopping = threading.Event()
        self._wake = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="ray-cluster", daemon=True)
        self.away = "the cluster has not been reached yet"

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def close(self) -> None:
        """Stop looking; actors stay."""
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5)
        if self._link is not None:
            self._link.close()

    def look(self) -> Look:
        """Return the last look at the cluster; raises ExecutorAwayError if it is too old to go by."""
        seen = self._look
        if seen is None or time.monotonic() - seen.began > self._settings.ray_away_s:
            raise ExecutorAwayError(self.away)
        return seen

    def call(self, op: str, timeout_s: float = CALL_TIMEOUT_S, **given: Any) -> Any:
        """Return an answer of Ray; raises ExecutorAwayError, at once if Ray has not answered lately."""
        self.look()
        link = self._link
        if link is None:
            raise ExecutorAwayError(self.away)
        return link.call(op, timeout_s, **given)

    def hurry(self) -> None:
        """Look again at once."""
        self._wake.set()

    def _loop(self) -> None:
        wait_s = self._settings.ray_poll_s
        while not self._stopping.is_set():
            try:
                self._turn()
                wait_s = self._settings.ray_poll_s
            except (ExecutorAwayError, OSError) as error:
                if str(error) != self.away:
                    log.warning("ray_away", address=self._settings.ray_address, reason=str(error))
                self.away = str(error)
                if self._link is not None:
                    self._link.close()
                    self._link = None
                wait_s = min(2 * wait_s, _LONGEST_WAIT_S)
            self._wake.wait(wait_s)
            self._wake.clear()

    def _turn(self) -> None:
        """Look once, over a new process if there is none."""
        address = str(self._settings.ray_address)
        timeout_s = CALL_TIMEOUT_S
        if self._link is None:
            access = probe(address)
            if access == "away":
                raise ExecutorAwayError(f"{address} does not answer")
            if access == "open" and not self._settings.ray_without_token:
                raise ExecutorAwayError(f"{address} runs anyone's programs: it has no token authentication")
            self._link, timeout_s = RayProcess(self._settings, self._namespace), OPEN_TIMEOUT_S
        began = time.monotonic()
        seen = self._link.call("look", timeout_s, offsets=self._offsets())
        if timeout_s == OPEN_TIMEOUT_S:
            log.info("ray_reached", address=address, namespace=self._namespace, nodes=len(seen["nodes"]))
        for name, actor in seen["actors"].items():
            if actor["offset"] >= 0:
                self._take(name, actor)
        self._look = Look(
            began=began,
            actors={name: _actor(given) for name, given in seen["actors"].items()},
            nodes=tuple(Node(**given) for given in seen["nodes"]),
            available=seen["available"],
        )
        self.away = ""


def _actor(given: Mapping[str, Any]) -> Actor:
    silent_s = given["silent_s"]
    return Actor(
        answered=silent_s is not None,
        silent_s=silent_s or 0.0,
        node=given.get("node", ""),
        exit_code=given.get("exit_code"),
        refused=given.get("refused", "") or given.get("unschedulable", ""),
        needs=given.get("needs", {}),
        log_left=given.get("log_left", 0),
    )
