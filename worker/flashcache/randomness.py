"""Random numbers from counted streams, never from global state.

Numbers of the rows of a batch are drawn by `uniform`, `normal` and `integers`: where ranks divide a batch
(`flashcache.parallel.ranks`), each draws those of the whole batch and keeps its own, so that every row has
the numbers that it would have in one process.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import sha256

import torch
from torch import Tensor

from flashcache.parallel.ranks import own_rows, whole_count

_Key = tuple[int, str, str, torch.device]


def generator_for(seed: int, stage: str, step: int, purpose: str, device: torch.device) -> torch.Generator:
    """Return a fresh random generator that depends on nothing but the arguments.

    Streams of different purposes are independent, and a resumed run continues as if never stopped.
    Where `KeptGenerators` are in use, it is one of these instead of a new one, with the same numbers.
    """
    kept = _KEPT.get()
    if kept is not None:
        return kept.get(seed, stage, step, purpose, device)
    generator = torch.Generator(device=device)
    generator.manual_seed(_number(seed, stage, step, purpose))
    return generator


class KeptGenerators:
    """Generators that outlive a step, one for each purpose: a CUDA graph draws from the same ones again."""

    def __init__(self) -> None:
        self._made: dict[_Key, torch.Generator] = {}

    @contextmanager
    def in_use(self, step: int) -> Iterator[None]:
        """Let `generator_for` return these, seeded for `step`, once for each purpose."""
        self.seed(step)
        before = _KEPT.set(self)
        try:
            yield
        finally:
            _KEPT.reset(before)

    def seed(self, step: int) -> None:
        """Let all generators begin with the numbers of `step`."""
        for (seed, stage, purpose, _), generator in self._made.items():
            generator.manual_seed(_number(seed, stage, step, purpose))

    def get(self, seed: int, stage: str, step: int, purpose: str, device: torch.device) -> torch.Generator:
        """Return the generator of a purpose; only a new one is seeded here."""
        key = (seed, stage, purpose, device)
        if key not in self._made:
            self._made[key] = torch.Generator(device=device)
            self._made[key].manual_seed(_number(seed, stage, step, purpose))
        return self._made[key]

    def all(self) -> Sequence[torch.Generator]:
        """Return all generators."""
        return list(self._made.values())


_KEPT: ContextVar[KeptGenerators | None] = ContextVar("kept_generators", default=None)


_BLOCK: ContextVar[int] = ContextVar("rows_in_a_block", default=1)


@contextmanager
def in_blocks_of(rows: int) -> Iterator[None]:
    """Draw numbers for rows of which as many follow from each row of the batch, one after the other."""
    before = _BLOCK.set(rows)
    try:
        yield
    finally:
        _BLOCK.reset(before)


def uniform(
    shape: Sequence[int],
    generator: torch.Generator | None,
    device: torch.device,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Return variates in [0, 1) of a shape whose first dimension counts rows of a batch."""
    whole = (whole_count(shape[0]), *shape[1:])
    return own_rows(torch.rand(whole, generator=generator, dtype=dtype, device=device), _BLOCK.get())


def normal(
    shape: Sequence[int],
    generator: torch.Generator | None,
    device: torch.device,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Return variates of the standard normal distribution; as `uniform`."""
    whole = (whole_count(shape[0]), *shape[1:])
    return own_rows(torch.randn(whole, generator=generator, dtype=dtype, device=device), _BLOCK.get())


def integers(high: int, count: int, generator: torch.Generator, device: torch.device) -> Tensor:
    """Return `count` integers from 0 to below `high`, for a row of a batch each."""
    whole = torch.randint(high, (whole_count(count),), generator=generator, device=device)
    return own_rows(whole, _BLOCK.get())


def _number(seed: int, stage: str, step: int, purpose: str) -> int:
    """Return the seed of a stream."""
    digest = sha256(f"{seed}/{stage}/{step}/{purpose}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1
