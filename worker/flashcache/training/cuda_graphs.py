"""Training steps as CUDA graphs: the host starts all operations of a step with one call.

A graph repeats the operations of one step on the same tensors. It needs fixed shapes (`flashcache.rows`), and
what differs from step to step must be on the device before: learning rates and scheduled weights, which are
filled in, and seeds, which a graph reads from its registered generators. Steps that do other things, other
phases, have graphs of their own. Tests without a GPU have a stand-in for `CudaCapture`.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any, Protocol, runtime_checkable

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.randomness import KeptGenerators
from flashcache.training.optimiser import Number, Steps

Values = dict[str, Number]
Replay = Callable[[], None]

GRADIENT = "gradient"
WARM_UP = 3
"""Steps of a phase without a graph: kernels are compiled and what is computed once is computed."""
CHECKED = 2
"""First steps of a graph that are compared with the same step without it: the second one has other seeds,
rates and weights than the captured one."""
TOLERANCES: dict[str, Any] = {"rtol": 0.02, "atol": 1e-4}
"""Of these comparisons; sums depend on the order of additions."""


@runtime_checkable
class Capture(Protocol):
    """Records work on a device."""

    def warm_up(self, work: Callable[[], Values]) -> Values:
        """Do the work and return its result, on a stream other than the default one."""
        ...

    def capture(
        self, work: Callable[[], Float[Tensor, " values"]], generators: Sequence[torch.Generator]
    ) -> tuple[Replay, Float[Tensor, " values"]]:
        """Return a function that does the work, and the tensor where its result will be; do nothing yet.

        Raises `RuntimeError` where the work cannot be captured.
        """
        ...


class CudaCapture:
    """Records work as CUDA graphs, which share one pool of memory: they never run at the same time."""

    def __init__(self, device: torch.device) -> None:
        self._stream = torch.cuda.Stream(device)
        self._pool = torch.cuda.graph_pool_handle()

    def warm_up(self, work: Callable[[], Values]) -> Values:
        """Do the work on a stream of its own, as a capture will, and return its result."""
        callers = torch.cuda.current_stream(self._stream.device)
        self._stream.wait_stream(callers)
        with torch.cuda.stream(self._stream):
            result = work()
        callers.wait_stream(self._stream)
        return result

    def capture(
        self, work: Callable[[], Float[Tensor, " values"]], generators: Sequence[torch.Generator]
    ) -> tuple[Replay, Float[Tensor, " values"]]:
        """Return a function that does the work, and the tensor where its result will be; do nothing yet."""
        graph = torch.cuda.CUDAGraph()
        for generator in generators:
            graph.register_generator_state(generator)
        with torch.cuda.graph(graph, pool=self._pool, stream=self._stream):
            result = work()
        return graph.replay, result


class Graphs:
    """Takes steps, from the fourth of each phase on by a graph; without `capture` all without.

    Where something cannot be captured, or a graph has other results than the same step without it, `problem`
    says so, and all further steps are taken without graphs.
    """

    def __init__(self, capture: Capture | None) -> None:
        self.problem: str | None = None
        self._capture = capture
        self._generators = KeptGenerators()
        self._taken: Counter[Hashable] = Counter()
        self._graphs: dict[Hashable, tuple[Replay, Float[Tensor, " values"]]] = {}
        self._names: dict[Hashable, tuple[str, ...]] = {}

    def take(self, phase: Hashable, step: int, differentiate: Callable[[], Values], steps: Steps) -> Values:
        """Add gradients by `differentiate`, take a step of the optimiser and return what it returned.

        `differentiate` begins by setting gradients to zero, uses each purpose of `generator_for` once, and
        depends on the step by nothing but these, tensors, and the phase.
        """

        def work() -> Values:
            values = differentiate()
            steps.apply()
            return values

        if self._capture is None or self.problem is not None:
            return work()
        self._taken[phase] += 1
        with self._generators.in_use(step):
            if self._taken[phase] <= WARM_UP:
                return self._capture.warm_up(work)
            expected = None
            if self._taken[phase] <= WARM_UP + CHECKED:
                expected = self._capture.warm_up(lambda: _with_gradient(differentiate(), steps))
                self._generators.seed(step)
                if phase not in self._graphs:
                    self._add(phase, tuple(expected), differentiate, steps)
            replayed = self._replay(phase) if phase in self._graphs else None
        if replayed is None:
            # With generators of its own: those of a capture that failed are unusable.
            return work()
        if expected is not None:
            self._compare(phase, expected, replayed)
        return {name: value for name, value in replayed.items() if name != GRADIENT}

    def forget(self) -> None:
        """Give the graphs and their memory back, where no step so far will come again."""
        self._graphs.clear()

    def _add(
        self, phase: Hashable, names: tuple[str, ...], differentiate: Callable[[], Values], steps: Steps
    ) -> None:
        """Capture the steps of a phase, if that is possible."""

        def captured() -> Tensor:
            values = _with_gradient(differentiate(), steps)
            steps.apply(torch.as_tensor(values[GRADIENT]))
            return torch.stack([torch.as_tensor(value) for value in values.values()])

        assert self._capture is not None
        try:
            self._graphs[phase] = self._capture.capture(captured, self._generators.all())
        except RuntimeError as error:
            self._give_up(f"steps of {phase} cannot be captured: {error}")
        self._names[phase] = names

    def _replay(self, phase: Hashable) -> Values:
        replay, place = self._graphs[phase]
        replay()
        # A copy: the next step of the phase writes to the same place.
        return dict(zip(self._names[phase], place.clone().unbind(), strict=True))

    def _compare(self, phase: Hashable, expected: Values, replayed: Values) -> None:
        """Give graphs up if a value differs."""
        for name, value in expected.items():
            pair = torch.as_tensor(replayed[name]), torch.as_tensor(value)
            if not torch.allclose(*pair, **TOLERANCES, equal_nan=True):
                self._give_up(f"{name} of {phase} is {pair[0]:.6g} by its graph and {pair[1]:.6g} without")

    def _give_up(self, problem: str) -> None:
        self.problem = problem
        self._graphs.clear()


def _with_gradient(values: Values, steps: Steps) -> Values:
    """Return values with the largest magnitude of a gradient."""
    return values | {GRADIENT: steps.largest_gradient()}
