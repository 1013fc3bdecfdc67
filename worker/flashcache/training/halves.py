"""Two halves of a batch on two cores, where torch may use two threads; else the whole batch at once.

Each half has a model of its own that shares all values and has gradients of its own; the gradients are added
in one fixed order.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import torch
from torch import Tensor, nn

from flashcache.data.ray_batches import RayBatch
from flashcache.physical.model import InverseModel
from flashcache.training.second_pass import half_of, half_the_threads, twin_of

T = TypeVar("T")


class Halves:
    """Differentiates a loss by the parameters of a part of the model on both halves of a batch.

    The result is the same, bit for bit, for the same number of threads. On a GPU, or with one thread, there
    is one half, the whole.
    """

    def __init__(self, model: InverseModel, part: Callable[[InverseModel], nn.Module]) -> None:
        device = next(model.parameters()).device
        self.count = 2 if device.type == "cpu" and torch.get_num_threads() > 1 else 1
        self._models = [model, twin_of(model)] if self.count > 1 else [model]
        own = half_of(torch.get_num_threads())
        self._pool = ThreadPoolExecutor(1, "half", torch.set_num_threads, (own,))
        self._pairs = [
            (own, other)
            for own, other in zip(part(model).parameters(), part(self._models[-1]).parameters(), strict=True)
            if own is not other
        ]
        for _, other in self._pairs:
            other.grad = torch.zeros_like(other)

    def part_of(self, batch: RayBatch, half: int) -> RayBatch:
        """Return the rays of half number `half`; the last one takes what does not divide."""
        share = len(batch) // self.count
        return batch.part(slice(half * share, None if half == self.count - 1 else share))

    def differentiate(self, loss_of: Callable[[InverseModel, int], tuple[Tensor, T]]) -> list[T]:
        """Add the gradient of the halves' mean loss to the parameters' gradients; return their results.

        `loss_of` gets a model and the number of a half and returns its loss and a result. It may run on
        another thread, so it draws its random numbers from a generator of its own.
        """

        def work(number: int) -> T:
            loss, result = loss_of(self._models[number], number)
            (loss / self.count).backward()
            return result

        if self.count == 1:
            return [work(0)]
        with half_the_threads(True):
            job = self._pool.submit(work, 1)
            results = [work(0), job.result()]
        with torch.no_grad():
            for own, other in self._pairs:
                if own.grad is None:
                    own.grad = other.grad.clone()
                else:
                    own.grad += other.grad
                other.grad.zero_()
        return results
