"""Parts of a batch on as many cores, each differentiated on its own thread.

Each part has a model of its own that shares all values and has gradients of its own; the gradients are added
in one fixed order, so that a step is the same, bit for bit, for the same number of parts.
"""

import copy
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch import Tensor, nn

from flashcache.data.ray_batches import RayBatch
from flashcache.physical.model import InverseModel

T = TypeVar("T")

LEAST_RAYS = 512
"""Rays below which a thread of its own costs a part more than it saves (docs/benchmarks/training-step.md)."""
_CHUNK_VALUES = 1 << 18
"""Values of a gradient that are added at once (1 MiB, a core's own cache)."""


def twin_of(model: InverseModel) -> InverseModel:
    """Return a model that shares all values with `model`, and has parameters and gradients of its own."""
    twin = copy.deepcopy(model)
    for own, other in zip(model.parameters(), twin.parameters(), strict=True):
        other.data = own.data
        other.grad = None
    for name, buffer in model.named_buffers():
        module, _, leaf = name.rpartition(".")
        setattr(twin.get_submodule(module), leaf, buffer)
    return twin


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
    """Differentiates a loss on parts of a batch at once, by the trained parameters of a part of the model.

    There are as many as torch may use threads, and as few as leave each `LEAST_RAYS`; on a GPU there is one,
    the whole batch. On a processor the operations of a part use one core: they are too small for more.
    """

    def __init__(
        self, model: InverseModel, trained: Callable[[InverseModel], nn.Module], num_rays: int
    ) -> None:
        """`trained` picks the module whose parameters get gradients; `num_rays` is the size of a batch."""
        device = next(model.parameters()).device
        threads = torch.get_num_threads() if device.type == "cpu" else 1
        self.count = max(1, min(threads, num_rays // LEAST_RAYS))
        self._threads = 1 if device.type == "cpu" else torch.get_num_threads()
        self._models = [model, *(twin_of(model) for _ in range(self.count - 1))]
        self._pool: ThreadPoolExecutor | None = None
        if self.count > 1:
            self._pool = ThreadPoolExecutor(self.count - 1, "part", torch.set_num_threads, (self._threads,))
        parameters = [[p for p in trained(each).parameters() if p.requires_grad] for each in self._models]
        self._shared = list(zip(*parameters, strict=True))
        for _, *others in self._shared:
            for other in others:
                other.grad = torch.zeros_like(other)

    def of(self, batch: RayBatch, part: int) -> RayBatch:
        """Return the rays of part number `part`; the last one takes what does not divide."""
        share = len(batch) // self.count
        return batch.part(slice(part * share, None if part == self.count - 1 else (part + 1) * share))

    def differentiate(self, loss_of: Callable[[InverseModel, int], tuple[Tensor, T]]) -> list[T]:
        """Add the gradient of the parts' mean loss to the parameters' gradients; return their results.

        `loss_of` gets a model and the number of a part and returns its loss and a result. It may run on
        another thread, so it draws its random numbers from a generator of its own.
        """

        def work(part: int) -> T:
            loss, result = loss_of(self._models[part], part)
            (loss / self.count).backward()
            return result

        with threads_of_operations(self._threads):
            if self._pool is None:
                return [work(0)]
            jobs = [self._pool.submit(work, part) for part in range(1, self.count)]
            results = [work(0), *(job.result() for job in jobs)]
            self._add_up()
        return results

    def _add_up(self) -> None:
        """Add the gradients of all parts to those of the model, in the order of the parts, and clear them."""
        tasks = []
        for own, *others in self._shared:
            if own.grad is None:
                own.grad = torch.zeros_like(own)
            flat = [parameter.grad.view(-1) for parameter in (own, *others)]
            tasks += [
                [one[start : start + _CHUNK_VALUES] for one in flat]
                for start in range(0, len(flat[0]), _CHUNK_VALUES)
            ]

        def add(number: int) -> None:
            with torch.no_grad():
                for total, *rest in tasks[number :: self.count]:
                    for other in rest:
                        total += other
                        other.zero_()

        assert self._pool is not None
        jobs = [self._pool.submit(add, number) for number in range(1, self.count)]
        add(0)
        for job in jobs:
            job.result()
