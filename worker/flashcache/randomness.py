"""Where random numbers come from: counted streams, never global state."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from hashlib import sha256

import torch

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
        """Let `generator_for` return these, seeded for `step`; it may be asked for a purpose once in each."""
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


def _number(seed: int, stage: str, step: int, purpose: str) -> int:
    """Return the seed of a stream."""
    digest = sha256(f"{seed}/{stage}/{step}/{purpose}".encode()).digest()
    return int.from_bytes(digest[:8], "little") >> 1
