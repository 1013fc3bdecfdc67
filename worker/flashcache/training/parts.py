"""Parts of a batch on as many cores, each differentiated by a process of its own.

The processes share the values of the model; each has gradients of its own, which are added in one fixed
order, so that a step is the same, bit for bit, for the same number of parts. Instead, ranks may divide the
batch (`flashcache.parallel.ranks`): then the batch here is this rank's part of it, and one part.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from flashcache.data.ray_batches import RayBatch
from flashcache.errors import ConfigError
from flashcache.parallel.processes import Processes
from flashcache.parallel.ranks import Bucket, Ranks, is_divided, mean_of_ranks
from flashcache.parallel.shared_memory import SharedMemory, bytes_for
from flashcache.physical.model import InverseModel
from flashcache.rows import shapes_are_fixed
from flashcache.training.optimiser import Number

LEAST_RAYS = 64
"""Rays below which a process of its own saves a part nothing (docs/benchmarks/training-step.md)."""


@runtime_checkable
class Losses(Protocol):
    """The losses of a stage of training; other processes get copies."""

    def __call__(
        self, model: InverseModel, batch: RayBatch, step: int, part: int, count: int
    ) -> tuple[Tensor, Any]:
        """Return the loss of part number `part` of `count`, and what the stage wants to know about it.

        `batch` is that part of the batch of step `step`. Random numbers depend on the arguments alone.
        """


def num_parts(num_rays: int, most: int) -> int:
    """Return the number of parts of a batch: at most `most`, and as few as leave each `LEAST_RAYS`."""
    return max(1, min(most, num_rays // LEAST_RAYS))


@contextmanager
def threads_of_operations(count: int) -> Iterator[None]:
    """Let each operation that this thread calls use `count` cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class Parts:
    """Differentiates losses on parts of a batch at once, by the trained parameters of a part of the model.

    There are as many as processes, and as few as leave each `LEAST_RAYS`; on a GPU there is one, the whole
    batch. On a processor the operations of a part use one core: they are too small for more.
    """

    def __init__(
        self,
        model: InverseModel,
        trained: Callable[[InverseModel], nn.Module],
        losses: Losses,
        num_rays: int,
        processes: Processes | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        """`trained` picks the module whose parameters get gradients; `num_rays` is the size of a batch.

        The model's values move into shared memory where there are several parts. Raises `ConfigError` for a
        batch with fewer rays than there are `ranks`.
        """
        if ranks is not None and num_rays < ranks.count:
            raise ConfigError(f"a batch of {num_rays} rays cannot be divided among {ranks.count} ranks")
        assert ranks is None or processes is None or processes.count == 1, "ranks or parts"
        on_cpu = next(model.parameters()).device.type == "cpu"
        available = processes.count if processes is not None and on_cpu else 1
        self.count = num_parts(num_rays, available)
        self._threads = 1 if on_cpu else torch.get_num_threads()
        self._processes = processes
        parameters = [parameter for parameter in trained(model).parameters() if parameter.requires_grad]
        self._own = _Part(losses, model, parameters, None, 0, self.count, 1 if ranks is None else ranks.count)
        self._bucket = None if ranks is None else Bucket(ranks, parameters)
        self._gradients: list[list[Tensor]] = []
        if self.count > 1:
            assert processes is not None
            block = share_values(model, self.count - 1, parameters)
            self._gradients = [[block.zeros_like(p) for p in parameters] for _ in range(self.count - 1)]
            parts = [
                _Part(losses, model, parameters, gradients, number, self.count)
                for number, gradients in enumerate(self._gradients, start=1)
            ]
            processes.give(parts, block)

    def of(self, batch: RayBatch, part: int) -> RayBatch:
        """Return the rays of part number `part`; the last one takes what does not divide."""
        share = len(batch) // self.count
        return batch.part(slice(part * share, None if part == self.count - 1 else (part + 1) * share))

    def differentiate(self, batch: RayBatch, step: int) -> list[Any]:
        """Add the gradient of the parts' mean loss to the parameters' gradients; return their results.

        With ranks gradients must be zero before: present values are added to those of the others.
        """
        questions = [(self.of(batch, part), step) for part in range(self.count)]
        with threads_of_operations(self._threads):
            if self.count == 1:
                results = [self._own(*questions[0])]
                if self._bucket is not None:
                    self._bucket.add()
                return results
            assert self._processes is not None
            results = self._processes.ask(questions, self._own)
        with threads_of_operations(self.count), torch.no_grad():
            for gradients in self._gradients:
                own = [p.grad for p in self._own.parameters if p.grad is not None]
                torch._foreach_add_(own, tuple(gradients))
        return results


@dataclass
class _Part:
    """One part of every batch: what its process needs to differentiate it."""

    losses: Losses
    model: InverseModel
    parameters: Sequence[nn.Parameter]
    gradients: Sequence[Tensor] | None
    """Where the gradients go, from zero on; None adds to those that the parameters have."""
    number: int
    count: int
    ranks: int = 1
    """Among how many ranks the batch is divided before."""

    def __call__(self, batch: RayBatch, step: int) -> Any:
        """Differentiate the loss of this part and return the result."""
        if self.gradients is not None:
            for parameter, gradient in zip(self.parameters, self.gradients, strict=True):
                parameter.grad = gradient.zero_()
        loss, result = self.losses(self.model, batch, step, self.number, self.count)
        (loss / (self.count * self.ranks)).backward()
        return result


def share_values(model: nn.Module, num_gradients: int, trained: Sequence[nn.Parameter]) -> SharedMemory:
    """Move a model's values into shared memory, with room for so many gradients of the trained ones."""
    values = {id(value): value for value in (*model.parameters(), *model.buffers())}.values()
    block = SharedMemory(bytes_for(values) + num_gradients * bytes_for(trained))
    for value in values:
        value.data = block.copy_of(value)
    return block


def numbers(terms: Mapping[str, Tensor]) -> dict[str, Number]:
    """Return the values of loss terms; with fixed shapes they stay on the device, for who will wait."""
    values = {name: value.detach() for name, value in terms.items()}
    return {name: value if shapes_are_fixed() else float(value) for name, value in values.items()}


def mean_terms(parts: Sequence[Mapping[str, Number]]) -> dict[str, Number]:
    """Return the mean of the parts' loss terms, by name; that of all ranks where they divide the batch."""
    means = {name: sum(part[name] for part in parts) / len(parts) for name in parts[0]}
    return dict(zip(means, mean_over_ranks(list(means.values())), strict=True))


def mean_over_ranks(values: Sequence[Number]) -> Sequence[Number]:
    """Return the means of the ranks' values, which are tensors then; without ranks the values."""
    if not is_divided():
        return values
    return mean_of_ranks(torch.stack([torch.as_tensor(value) for value in values])).unbind()
