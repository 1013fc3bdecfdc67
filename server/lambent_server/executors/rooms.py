"""Room for further runs: places and GPUs of one machine, or the resources of a cluster's nodes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

CPU, GPU, MEMORY = "CPU", "GPU", "memory"
# Ray counts in parts of 10 000.
_LEAST = 1e-4


class LocalRoom:
    """Places of this machine, and the numbers of its free GPUs."""

    def __init__(self, slots: int, free: Sequence[int]) -> None:
        self._slots = slots
        self._free = list(free)

    def most_gpus(self) -> int | None:
        """Return how many GPUs the next run can have; None if there is no room for any."""
        return len(self._free) if self._slots > 0 else None

    def take(self, gpus: int) -> tuple[int, ...]:
        """Take a place; return the numbers of the run's GPUs."""
        taken, self._free = tuple(self._free[:gpus]), self._free[gpus:]
        self._slots -= 1
        return taken


@dataclass(frozen=True, kw_only=True, slots=True)
class Needs:
    """What a run needs of a node."""

    cpus: float
    gpus: int
    memory_bytes: int

    def as_resources(self) -> dict[str, float]:
        """Return the needs by Ray's names; those that are 0 are left out."""
        given = {CPU: self.cpus, GPU: float(self.gpus), MEMORY: float(self.memory_bytes)}
        return {name: amount for name, amount in given.items() if amount}


class ClusterRoom:
    """The free resources of a cluster's nodes, without those of runs whose node is known."""

    def __init__(self, nodes: Mapping[str, Mapping[str, float]], cpus: float, memory_bytes: int) -> None:
        """Begin with empty nodes: resources by node and name. A run needs `cpus` and `memory_bytes`."""
        self._nodes = {node: dict(resources) for node, resources in nodes.items()}
        self._all = dict.fromkeys((CPU, GPU, MEMORY), float("inf"))
        self._cpus = cpus
        self._memory_bytes = memory_bytes
        self._ahead = 0

    def use(self, node: str, needs: Needs) -> None:
        """Take out what a run on a node uses."""
        if node in self._nodes:
            self._take(self._nodes[node], needs)

    def limit(self, available: Mapping[str, float]) -> None:
        """Count no more, on all nodes together, than is available beside others who use the cluster."""
        self._all = {name: available.get(name, 0.0) for name in self._all}

    def use_somewhere(self, needs: Needs) -> None:
        """Take out what a run will use that has no node yet."""
        place = self._place(needs)
        if place is not None:
            self._take(place, needs)
        self._take(self._all, needs)

    def allow_ahead(self, runs: int) -> None:
        """Let so many runs be started beyond what is free, for Ray to get machines for."""
        self._ahead = runs

    def most_gpus(self) -> int | None:
        """Return how many GPUs the next run can have; None if there is no room for any."""
        if self._ahead > 0:
            return 2**15
        plain = self._needs(0)
        fitting = [node for node in self._nodes.values() if _fits(node, plain)]
        if not fitting or not _fits(self._all, plain):
            return None
        gpus = min(max(node.get(GPU, 0.0) for node in fitting), self._all[GPU])
        return int(max(gpus, 0.0) + _LEAST)

    def take(self, gpus: int) -> tuple[int, ...]:
        """Take the room of a run; Ray chooses its node and GPUs."""
        needs = self._needs(gpus)
        if self._place(needs) is None:
            self._ahead -= 1
        self.use_somewhere(needs)
        return ()

    def _needs(self, gpus: int) -> Needs:
        return Needs(cpus=self._cpus, gpus=gpus, memory_bytes=self._memory_bytes)

    def _place(self, needs: Needs) -> dict[str, float] | None:
        """Return the node with the fewest GPUs, and then processors, left over by a run."""
        fitting = [node for node in self._nodes.values() if _fits(node, needs)]
        return min(fitting, key=lambda node: (node.get(GPU, 0.0), node.get(CPU, 0.0)), default=None)

    @staticmethod
    def _take(resources: dict[str, float], needs: Needs) -> None:
        for name, amount in needs.as_resources().items():
            resources[name] = resources.get(name, 0.0) - amount


def _fits(resources: Mapping[str, float], needs: Needs) -> bool:
    given = needs.as_resources()
    return all(resources.get(name, 0.0) + _LEAST >= amount for name, amount in given.items())
