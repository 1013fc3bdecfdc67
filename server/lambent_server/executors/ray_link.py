"""A process that speaks with a Ray cluster for a server: requests and answers are lines of JSON.

Ray ends a process whose cluster is unavailable for a minute, and blocks its calls until then. This one may
end.

    python -m lambent_server.executors.ray_link ADDRESS NAMESPACE
"""

import json
import os
import queue
import signal
import sys
import threading
import time
from typing import Any, TextIO

import ray
from ray.exceptions import ActorUnschedulableError, GetTimeoutError, RayActorError

from lambent_server.executors import ray_node

_ANSWER_S = 1.0
"""How long a look waits for actors; those that answer later are seen by the next one."""
_FAREWELL_S = 3.0


class Actors:
    """The actors of one namespace."""

    def __init__(self, namespace: str) -> None:
        self._namespace = namespace
        ray.cloudpickle.register_pickle_by_value(ray_node)
        self._holder = ray.remote(ray_node.RunHolder)
        self._handles: dict[str, Any] = {}
        self._asked: dict[str, Any] = {}
        self._known: dict[str, dict[str, Any]] = {}
        self._answered_at: dict[str, float] = {}
        self._leaving: dict[str, float] = {}

    def start(self, name: str, launch: dict[str, Any], unfit: list[str]) -> None:
        """Order an actor; Ray finds a node for it."""
        needs = launch["needs"]
        options: dict[str, Any] = {
            "name": name,
            "namespace": self._namespace,
            "lifetime": "detached",
            "max_restarts": 0,
            "num_cpus": needs["cpus"],
        }
        if needs["gpus"]:
            options["num_gpus"] = needs["gpus"]
        if needs["memory_bytes"]:
            options["memory"] = needs["memory_bytes"]
        if unfit:
            options["label_selector"] = {"ray.io/node-id": f"!in({','.join(unfit)})"}
        self._handles[name] = self._holder.options(**options).remote(launch)

    def look(self, offsets: dict[str, int]) -> dict[str, Any]:
        """Return the actors that exist, what those say that answer, and the nodes."""
        names = ray.util.list_named_actors(all_namespaces=True)
        here = {each["name"] for each in names if each["namespace"] == self._namespace}
        for gone in set(self._handles) - here:
            for kept in (self._handles, self._asked, self._known, self._answered_at, self._leaving):
                kept.pop(gone, None)
        for name in here:
            self._ask(name, offsets.get(name, -1))
        asked = dict(self._asked)
        if asked:
            ray.wait(list(asked.values()), num_returns=len(asked), timeout=_ANSWER_S)
        actors = {name: self._answer(name) for name in here}
        nodes = [
            {
                "id": node["NodeID"],
                "name": node["NodeManagerHostname"] or node["NodeManagerAddress"],
                "resources": node["Resources"],
            }
            for node in ray.nodes()
            if node["Alive"]
        ]
        return {"actors": actors, "nodes": nodes, "available": ray.available_resources()}

    def _handle(self, name: str) -> Any:
        if name not in self._handles:
            try:
                self._handles[name] = ray.get_actor(name, namespace=self._namespace)
            except ValueError:
                return None
        return self._handles[name]

    def _ask(self, name: str, offset: int) -> None:
        if name not in self._asked and (handle := self._handle(name)) is not None:
            self._asked[name] = handle.status.remote(offset)

    def _answer(self, name: str) -> dict[str, Any]:
        """Return what is known of an actor; only a new answer has a piece of the log."""
        known = {**self._known.get(name, {}), "log": "", "offset": -1}
        reference = self._asked.get(name)
        if reference is not None and ray.wait([reference], timeout=0)[0]:
            del self._asked[name]
            try:
                known = ray.get(reference, timeout=_ANSWER_S)
                self._answered_at[name] = time.monotonic()
            except ActorUnschedulableError as error:
                known = {**known, "unschedulable": str(error)}
            except (RayActorError, GetTimeoutError):
                # The next look does not find it any more.
                pass
        self._known[name] = known
        answered_at = self._answered_at.get(name)
        silent_s = None if answered_at is None else time.monotonic() - answered_at
        return {**known, "silent_s": silent_s}

    def signal(self, name: str, number: int) -> None:
        """Send a signal to a run; an actor that does not answer, or has no node yet, is killed."""
        handle = self._handle(name)
        if handle is None:
            return
        placed = name in self._answered_at
        sent = placed and ray.wait([handle.signal.remote(number)], timeout=_FAREWELL_S)[0]
        if not sent and (number == signal.SIGKILL or not placed):
            ray.kill(handle, no_restart=True)

    def forget(self, name: str) -> None:
        """End an actor, and what there is of its run."""
        handle = self._handle(name)
        if handle is None:
            return
        leaving_since = self._leaving.setdefault(name, time.monotonic())
        if name in self._answered_at and time.monotonic() - leaving_since < _FAREWELL_S:
            # Nothing comes of it if it is gone already.
            handle.leave.remote()
        else:
            ray.kill(handle, no_restart=True)


def _read(lines: TextIO, requests: "queue.SimpleQueue[dict[str, Any]]") -> None:
    """Pass requests on; end this process when the server has."""
    for line in lines:
        requests.put(json.loads(line))
    os._exit(0)


def main() -> None:
    """Connect, and answer requests until the server ends."""
    address, namespace = sys.argv[1:]
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    # Whatever Ray prints.
    os.dup2(2, 1)
    requests: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(sys.stdin, requests), daemon=True).start()
    given: dict[str, Any] = {"logging_level": "warning", "log_to_driver": False}
    ray.init(address=address, namespace=namespace, **given)
    actors = Actors(namespace)
    while True:
        request = requests.get()
        try:
            result = getattr(actors, request["op"])(**request["given"])
            answer = {"result": result}
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}"}
        print(json.dumps({"id": request["id"], **answer}), file=answers, flush=True)


if __name__ == "__main__":
    main()
