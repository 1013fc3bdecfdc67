"""Rows of a batch that count: picked out, or left in place among rows of weight zero.

Picking saves the work for the others, but only the device knows the number of rows, and a host that reads it
from a GPU waits. With fixed shapes all rows stay, others get harmless inputs and no weight, and
each step has the same shapes.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from flashcache.parallel.ranks import sum_of_ranks, whole_count

_FIXED: ContextVar[bool] = ContextVar("fixed_shapes", default=False)


@contextmanager
def fixed_shapes(choice: bool = True) -> Iterator[None]:
    """Keep rows that do not count, so that no shape depends on values; False picks rows out, as elsewhere."""
    before = _FIXED.set(choice)
    try:
        yield
    finally:
        _FIXED.reset(before)


def shapes_are_fixed() -> bool:
    """Return whether rows that do not count stay in place."""
    return _FIXED.get()


@dataclass(frozen=True, slots=True)
class Rows:
    """Some rows of a batch, or all of them with a mask of those that count."""

    index: Int[Tensor, " some"] | None
    """Positions of the rows that count; None: all rows stay in place."""
    counted: Bool[Tensor, " rows"] | None
    """Which rows count; None: all that are left."""

    @classmethod
    def where(cls, counted: Bool[Tensor, " rows"]) -> "Rows":
        """Return the rows in which `counted` is true."""
        if shapes_are_fixed():
            return cls(None, counted)
        return cls(counted.nonzero().squeeze(-1), None)

    @classmethod
    def all(cls, count: int, device: torch.device) -> "Rows":
        """Return all of `count` rows."""
        return cls(None if shapes_are_fixed() else torch.arange(count, device=device), None)

    def of(self, values: Tensor) -> Tensor:
        """Return the rows of `values`."""
        return values if self.index is None else values[self.index]

    def into(self, background: Tensor, values: Tensor) -> Tensor:
        """Return `background` [rows, ...] with `values` in the rows that count."""
        if self.index is not None:
            return background.index_copy(0, self.index, values)
        if self.counted is None:
            return values
        return torch.where(self.counted.reshape(-1, *(1,) * (values.dim() - 1)), values, background)


def mean_where(values: Float[Tensor, "rows *rest"], counted: Bool[Tensor, " rows"]) -> Float[Tensor, ""]:
    """Return the mean over the rows that count; without any it is 0 with fixed shapes, else NaN.

    Where ranks divide a batch, the mean of what they return is that over the whole batch.
    """
    if not shapes_are_fixed():
        return values[counted].mean()
    of_rows = values.reshape(len(values), -1).mean(dim=-1)
    total = torch.where(counted, of_rows, torch.zeros_like(of_rows)).sum()
    return whole_count(1) * total / sum_of_ranks(counted.sum()).clamp_min(1)
