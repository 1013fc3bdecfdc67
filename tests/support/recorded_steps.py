"""A stand-in for CUDA graphs: operations are recorded with their tensors and repeated on the same memory.

As in a CUDA graph, whatever Python computed in the recorded step stays as it was.
"""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves


class _Recorder(TorchDispatchMode):
    def __init__(self) -> None:
        super().__init__()
        self.calls: list[tuple[Any, Any, Any, list[torch.Tensor]]] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = func(*args, **(kwargs or {}))
        self.calls.append((func, args, kwargs or {}, tensors(result)))
        return result


def tensors(values: Any) -> list[torch.Tensor]:
    """Return the tensors in a nest of lists and tuples."""
    return [value for value in tree_leaves(values) if isinstance(value, torch.Tensor)]


class Recorded:
    """`flashcache.training.cuda_graphs.Capture` on a processor, without its compiled kernels."""

    def __init__(self) -> None:
        self.stage: StageOne | StageTwo | None = None
        self.num_captured = self.num_replayed = 0
        self.fails = False

    def warm_up(self, work: Callable[[], Any]) -> Any:
        """Do the work."""
        return work()

    def capture(
        self, work: Callable[[], torch.Tensor], generators: Sequence[torch.Generator]
    ) -> tuple[Callable[[], None], torch.Tensor]:
        """Do the work and put everything back as it was."""
        if self.fails:
            raise RuntimeError("no capture today")
        assert self.stage is not None
        held = [*self.stage.model.parameters(), *tensors(self.stage.optimiser.state_dict()["state"])]
        held += [p.grad for p in self.stage.model.parameters() if p.grad is not None]
        held.append(self.stage.steps._skipped)
        before = [value.detach().clone() for value in held]
        states = [generator.get_state() for generator in generators]
        with _Recorder() as recorder:
            place = work()
        with torch.no_grad():
            for value, old in zip(held, before, strict=True):
                value.copy_(old)
        for generator, state in zip(generators, states, strict=True):
            generator.set_state(state)
        self.num_captured += 1

        def replay() -> None:
            self.num_replayed += 1
            with torch.no_grad():
                for func, args, kwargs, places in recorder.calls:
                    found = tensors(func(*args, **kwargs))
                    for old, new in zip(places, found, strict=True):
                        if old.data_ptr() != new.data_ptr():
                            old.detach().copy_(new)

        return replay, place.detach()


def rates_as_tensors(stage: StageOne | StageTwo) -> None:
    """Let the optimiser read its rates from tensors, as on a GPU."""
    for group in stage.optimiser.param_groups:
        group["lr"] = torch.tensor(group["lr"])
