"""The space of the data folder that bodies under way take, so that together they never pass the floor.

Bytes are counted before they are written, and checked against what is free then: also of requests that began
while there was enough. A body counts until its file is stored or deleted.
"""

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from lambent_server.api.problems import Problem

RUNS_PART = 0.5
"""Runs may go down to this part of the floor: what they have computed should not wait until users delete
something. The rest is left to the database."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Allowance:
    """How many bytes of its quota a tenant may still send; `refuse` makes the problem for more."""

    bytes: float
    refuse: Callable[[float], Problem]


class Space:
    """What there is, and who uses it. Safe to use from several threads."""

    def __init__(self, free_bytes: Callable[[], int], *, floor_bytes: int, tenant_share: float) -> None:
        self._free_bytes = free_bytes
        self._floor_bytes = floor_bytes
        self._tenant_share = tenant_share
        self._lock = threading.Lock()
        self._coming = 0
        self._held: Counter[str] = Counter()

    def require(self, floor_part: float = 1.0) -> None:
        """Raise `disk_floor` if less than the floor is free."""
        with self._lock:
            self._require(0, floor_part)

    @contextmanager
    def body(
        self, tenant_id: str, *, allowance: Allowance | None = None, floor_part: float = 1.0
    ) -> Iterator["Body"]:
        """Yield what counts the bytes of one body inside the `with` block."""
        body = Body(self, tenant_id, allowance, floor_part)
        try:
            yield body
        finally:
            with self._lock:
                self._held -= Counter({tenant_id: body.size})

    @contextmanager
    def taking(self, size: int, floor_part: float = 1.0) -> Iterator[None]:
        """Keep so many bytes for what is written inside the `with` block; raises `disk_floor`."""
        with self._lock:
            self._require(size, floor_part)
            self._coming += size
        try:
            yield
        finally:
            with self._lock:
                self._coming -= size

    def _above_floor(self, floor_part: float) -> float:
        return self._free_bytes() - floor_part * self._floor_bytes - self._coming

    def _require(self, size: int, floor_part: float) -> None:
        if size > self._above_floor(floor_part):
            raise Problem(
                507,
                "disk_floor",
                f"{self._free_bytes()} bytes are free, but {int(floor_part * self._floor_bytes)} must stay "
                f"free when {size + self._coming} more are written; delete scenes or add disk space",
                retryable=True,
            )

    def _expect(self, body: "Body", size: int) -> None:
        """Look whether a body of a tenant may have `size` more bytes; the lock is held."""
        self._require(size, body.floor_part)
        held = self._held[body.tenant_id] + size
        if body.allowance is not None and held > body.allowance.bytes:
            raise body.allowance.refuse(held)
        # Of what there would be without any body under way; runs do not compete with uploads.
        most = self._tenant_share * (self._above_floor(body.floor_part) + self._held.total())
        if body.floor_part == 1.0 and held > most:
            raise Problem(
                507,
                "uploads_share",
                f"{held} bytes of this organisation would be under way, and its share of the free space is "
                f"{int(most)}; send less at once, or add disk space",
                retryable=True,
            )


@dataclass(slots=True, eq=False)
class Body:
    """The bytes of one body."""

    _space: Space
    tenant_id: str
    allowance: Allowance | None
    floor_part: float
    size: int = 0

    def expect(self, size: int) -> None:
        """Refuse a body of an announced size that has no room now; nothing is kept for it."""
        with self._space._lock:
            self._space._expect(self, size)

    @contextmanager
    def writing(self, size: int) -> Iterator[None]:
        """Count bytes that are written inside the `with` block; raises the problem if there is no room."""
        with self._space._lock:
            self._space._expect(self, size)
            self._space._held[self.tenant_id] += size
            self._space._coming += size
            self.size += size
        try:
            yield
        finally:
            with self._space._lock:
                self._space._coming -= size
