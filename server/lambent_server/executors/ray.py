"""Run processes on the nodes of a Ray cluster, each kept by a detached actor with the name of the run.

The name follows from the job's row, so any server on the same database finds the run, also one that started
later. Ray only places; whether a run is wanted is decided by the row.
"""

import base64
import contextlib
import hashlib
import inspect
import signal
import threading
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import structlog

from lambent_server.core.settings import Settings
from lambent_server.executors import (
    ExecutorAwayError,
    Gone,
    Handle,
    Launch,
    installed,
    run_name,
    told_in_environment,
)
from lambent_server.executors.local import PASSED_ON, SECRET
from lambent_server.executors.ray_cluster import Actor, Cluster, Look
from lambent_server.executors.rooms import GPU, ClusterRoom, Needs

log = structlog.get_logger()

_DRAINED_S = 30.0
"""How long the rest of a log is waited for after the run's end."""
_BRIEF_S = 5.0
"""Longest wait for Ray to take an order that the next round repeats."""
_FOLLOWED_S = 60.0
_UNFIT_S = 300.0
"""How long a node is left out on which a run was refused."""


def namespace_of(settings: Settings, secret: str) -> str:
    """Return the namespace of the actors of all servers that share `secret`, and of no others."""
    return settings.ray_namespace or f"lambent-{hashlib.sha256(secret.encode()).hexdigest()[:16]}"


class RayExecutor:
    """Run processes kept by actors, and the cluster as it was seen last."""

    runs_elsewhere = True

    def __init__(self, settings: Settings, secret: str) -> None:
        self._settings = settings
        self._namespace = namespace_of(settings, secret)
        self._lock = threading.Lock()
        self._started: dict[str, float] = {}
        self._followed: dict[str, float] = {}
        self._waiting: dict[str, float] = {}
        self._ended: dict[str, float] = {}
        self._unfit: dict[str, float] = {}
        self._answered: dict[str, tuple[Actor, float]] = {}
        """Actors that have ever answered, as they did last, and when."""
        self._most_gpus = 0
        self._installed: dict[str, str] | None = None
        self._cluster = Cluster(settings, self._namespace, self._offsets, self._take_log)

    def open(self) -> None:
        """Begin to look at the cluster."""
        self._installed = installed.installed()
        self._cluster.start()

    def close(self) -> None:
        """Stop looking at the cluster; runs continue."""
        self._cluster.close()

    # What there is room for.

    def room(self, own: Sequence[Handle], others: Sequence[Handle]) -> ClusterRoom:
        """Return what is free on the nodes; nothing while the cluster is unavailable."""
        settings = self._settings
        memory_bytes = settings.run_memory_bytes or 0
        try:
            look = self._look()
        except ExecutorAwayError:
            return ClusterRoom({}, settings.ray_run_cpus, memory_bytes)
        fit = {node.id: node.resources for node in look.nodes if node.id not in self._unfit_now()}
        room = ClusterRoom(fit, settings.ray_run_cpus, memory_bytes)
        room.limit(look.available)
        for actor in look.actors.values():
            if actor.answered:
                room.use(actor.node, Needs(**actor.needs))
        homeless = [
            handle for handle in (*own, *others) if self._is_ours(handle) and not self._has_node(look, handle)
        ]
        for handle in homeless:
            if "needs" in handle:
                room.use_somewhere(Needs(**handle["needs"]))
        room.allow_ahead(max(settings.ray_ahead - len(homeless), 0))
        return room

    @staticmethod
    def _has_node(look: Look, handle: Handle) -> bool:
        actor = look.actors.get(handle.get("run", ""))
        return actor is not None and actor.answered

    def _look(self) -> Look:
        """Return the last look at the cluster, with what its actors said before that did not answer to it.

        The process that asks them may be a new one, which has heard of none yet. Raises ExecutorAwayError if
        the look is too old to go by.
        """
        look, at = self._cluster.look(), time.monotonic()
        with self._lock:
            for run, actor in look.actors.items():
                if actor.answered:
                    self._answered[run] = (actor, look.began - actor.silent_s)
            self._answered = {run: known for run, known in self._answered.items() if run in look.actors}
            before = {
                run: replace(known, silent_s=at - answered_at)
                for run, (known, answered_at) in self._answered.items()
                if not look.actors[run].answered
            }
        return replace(look, actors={**look.actors, **before})

    def max_gpus(self) -> int:
        """Return how many GPUs the largest node has had since this server began, or the settings say."""
        if self._settings.ray_node_gpus is not None:
            return self._settings.ray_node_gpus
        with contextlib.suppress(ExecutorAwayError):
            gpus = [int(node.resources.get(GPU, 0)) for node in self._cluster.look().nodes]
            self._most_gpus = max([self._most_gpus, *gpus])
        return self._most_gpus

    def num_places(self) -> int:
        """Return how many runs without GPUs the nodes have processors and memory for; at least 1."""
        settings = self._settings
        plain = Needs(cpus=settings.ray_run_cpus, gpus=0, memory_bytes=settings.run_memory_bytes or 0)
        try:
            nodes = self._cluster.look().nodes
        except ExecutorAwayError:
            return 1
        needs = plain.as_resources().items()
        return max(1, sum(int(min(n.resources.get(k, 0) // v for k, v in needs)) for n in nodes))

    # Starting and stopping.

    def start(self, launch: Launch) -> Handle:
        """Order the actor of a run; raises ExecutorAwayError if Ray does not take the order."""
        run = run_name(launch.job_id, launch.run)
        servers = [address for address in launch.servers if not address.startswith("unix:")]
        needs = Needs(
            cpus=self._settings.ray_run_cpus,
            gpus=launch.num_gpus,
            memory_bytes=self._settings.run_memory_bytes or 0,
        )
        given = {
            "job_id": launch.job_id,
            "run": launch.run,
            "namespace": self._namespace,
            "folder": None if self._settings.ray_folder is None else str(self._settings.ray_folder),
            "command": self._command(),
            "environment": [*PASSED_ON, *self._settings.run_environment],
            "named": list(self._settings.run_environment),
            "secret": SECRET.pattern,
            "sandbox": self._settings.sandbox,
            "memory_bytes": self._settings.run_memory_bytes,
            "needs": asdict(needs),
            "installed": self._installed,
            "installed_code": inspect.getsource(installed),
            "identity": told_in_environment(
                replace(launch, address=servers[0], servers=tuple(servers)), self._settings
            ),
        }
        self._cluster.call("start", name=run, launch=given, unfit=sorted(self._unfit_now()))
        with self._lock:
            self._started[run] = time.monotonic()
        self._cluster.hurry()
        return {
            "actor": run,
            "run": run,
            "cluster": self._settings.ray_address,
            "namespace": self._namespace,
            "needs": asdict(needs),
            "host": "",
            "gpus": [],
        }

    def _command(self) -> list[str | None]:
        """Return the command of a run; None stands for the interpreter of the node."""
        command: list[str | None] = list(self._settings.run_command)
        default = type(self._settings).model_fields["run_command"].default
        return [None, *command[1:]] if self._settings.run_command == default else command

    def stop(self, handle: Handle, *, force: bool) -> None:
        """Signal the process group: SIGTERM, or SIGKILL with `force`; a run without a node is taken back."""
        number = signal.SIGKILL if force else signal.SIGTERM
        try:
            self._cluster.call("signal", _BRIEF_S, name=handle["run"], number=int(number))
        except ExecutorAwayError as error:
            # It hears by its heartbeat that it has to end.
            log.warning("ray_run_not_signalled", run=handle["run"], reason=str(error))
        self._cluster.hurry()

    # What became of runs.

    def sees(self, handle: Handle) -> bool:
        """Return whether the run belongs to this cluster, and the cluster answers at present."""
        try:
            self._cluster.look()
        except ExecutorAwayError:
            return False
        return self._is_ours(handle)

    def _is_ours(self, handle: Handle) -> bool:
        """Return whether a run belongs to this cluster: by the address, or because the cluster lists it.

        Servers may call the same cluster by different addresses.
        """
        if (
            handle.get("executor", "ray") != "ray"
            or handle.get("namespace", self._namespace) != self._namespace
        ):
            return False
        if handle.get("cluster", self._settings.ray_address) == self._settings.ray_address:
            return True
        return handle.get("run", "") in self.runs()

    def adopt(self, handle: Handle) -> bool:
        """Return whether the run belongs to this cluster: then every server sees it alike."""
        return self._is_ours(handle)

    def poll(self, handle: Handle, *, has_reported: bool = False) -> Gone | None:
        """Return None while the run exists or waits for a node, else how it ended.

        Raises ExecutorAwayError while the cluster, or the run's node, does not answer.
        """
        if not self._is_ours(handle):
            raise ExecutorAwayError("the run belongs to another cluster")
        run = handle["run"]
        with self._lock:
            self._followed[run] = time.monotonic()
        look = self._look()
        actor = look.actors.get(run)
        if actor is None:
            if self._started.get(run, 0.0) > look.began:
                return None
            self._drop(run)
            return Gone(None)
        if has_reported and actor.refused:
            self.forget(run)
            return Gone(None)
        if has_reported and not actor.answered:
            raise ExecutorAwayError("the actor of the run does not answer")
        if actor.refused:
            return self._not_placed(run, actor.node, f"{self._node_name(look, actor)}: {actor.refused}")
        if not actor.answered:
            return self._wait_for_node(run)
        if actor.exit_code is not None:
            since = self._ended.setdefault(run, time.monotonic())
            whole = actor.log_left == 0 or time.monotonic() - since > _DRAINED_S
            return Gone(actor.exit_code) if whole else None
        if actor.silent_s > self._settings.lost_after_s:
            raise ExecutorAwayError(f"{self._node_name(look, actor)} does not answer")
        return None

    def _wait_for_node(self, run: str) -> Gone | None:
        since = self._waiting.setdefault(run, time.monotonic())
        limit_s = self._settings.ray_place_s
        if time.monotonic() - since <= limit_s:
            return None
        return self._not_placed(run, "", f"no node of the Ray cluster had room within {limit_s:g} s")

    def _not_placed(self, run: str, node: str, reason: str) -> Gone:
        if node:
            self._unfit[node] = time.monotonic()
        log.warning("ray_run_not_placed", run=run, node=node, reason=reason)
        self.forget(run)
        return Gone(None, not_placed=reason)

    @staticmethod
    def _node_name(look: Look, actor: Actor) -> str:
        return next((node.name for node in look.nodes if node.id == actor.node), "a node")

    def _unfit_now(self) -> set[str]:
        limit = time.monotonic() - _UNFIT_S
        self._unfit = {node: since for node, since in self._unfit.items() if since > limit}
        return set(self._unfit)

    # Runs that no job needs any more.

    def runs(self) -> frozenset[str]:
        """Return the names of the runs that have an actor, as of the last look."""
        try:
            return frozenset(self._cluster.look().actors)
        except ExecutorAwayError:
            return frozenset()

    def forget(self, run: str) -> None:
        """End the actor of a run and what there is of its processes and files."""
        self._drop(run)
        try:
            self._cluster.call("forget", _BRIEF_S, name=run)
        except ExecutorAwayError as error:
            # The next look finds it again.
            log.warning("ray_run_not_forgotten", run=run, reason=str(error))

    def _drop(self, run: str) -> None:
        with self._lock:
            for known in (self._started, self._followed, self._waiting, self._ended):
                known.pop(run, None)

    # Output of runs.

    def _log_of(self, run: str) -> Path:
        job_id, _, number = run.rpartition("/")
        return self._settings.runs / job_id / f"run-{number}.log"

    def _offsets(self) -> dict[str, int]:
        """Return from where on the output of the runs is wanted that this server looks after."""
        with self._lock:
            limit = time.monotonic() - _FOLLOWED_S
            self._followed = {run: at for run, at in self._followed.items() if at > limit}
            followed = list(self._followed)
        paths = {run: self._log_of(run) for run in followed}
        return {run: path.stat().st_size if path.exists() else 0 for run, path in paths.items()}

    def _take_log(self, run: str, piece: dict[str, Any]) -> None:
        """Append new output of a run to its file."""
        data = base64.b64decode(piece["log"])
        path = self._log_of(run)
        size = path.stat().st_size if path.exists() else 0
        if data and size == piece["offset"]:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("ab") as file:
                file.write(data)
