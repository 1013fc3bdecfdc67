"""Transfers between a run and the store of its server, by addresses that the server signs."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import httpx2

PIECE_BYTES = 1 << 20
_TIMEOUT = httpx2.Timeout(60.0, connect=5.0)


class StoreAwayError(Exception):
    """The store does not answer, or the address has expired: ask the server again, and try again."""


class Store:
    """The run's line to the store; it has no secrets, only addresses. Safe to use from several threads."""

    def __init__(self) -> None:
        self._client = httpx2.Client(timeout=_TIMEOUT)
        self.reached = False
        """Whether the store has answered at least once."""

    def close(self) -> None:
        """Close all connections."""
        self._client.close()

    def put(self, path: Path, offset: int, size_bytes: int, url: str, headers: Mapping[str, str]) -> None:
        """Send a range of a file."""

        def pieces() -> Iterator[bytes]:
            left = size_bytes
            with path.open("rb") as file:
                file.seek(offset)
                while piece := file.read(min(PIECE_BYTES, left)):
                    yield piece
                    left -= len(piece)

        sent = {**headers, "Content-Length": str(size_bytes), "Content-Type": "application/octet-stream"}
        try:
            status = self._client.put(url, content=pieces(), headers=sent).status_code
        except httpx2.TransportError as error:
            raise StoreAwayError(str(error) or type(error).__name__) from error
        self.reached = True
        if status >= 300:
            raise StoreAwayError(f"the store answers with {status}")

    def get(self, url: str, target: Path) -> None:
        """Write what is at an address to `target`; what an interrupted transfer has left there is kept.

        Raises FileNotFoundError if there is nothing.
        """
        have = target.stat().st_size if target.exists() else 0
        headers = {"Range": f"bytes={have}-"} if have else {}
        try:
            with self._client.stream("GET", url, headers=headers) as answer:
                self.reached = True
                if answer.status_code == 416:
                    return
                if answer.status_code == 404:
                    raise FileNotFoundError(url.partition("?")[0])
                if answer.status_code not in (200, 206):
                    raise StoreAwayError(f"the store answers with {answer.status_code}")
                with target.open("ab" if answer.status_code == 206 else "wb") as file:
                    for piece in answer.iter_bytes(PIECE_BYTES):
                        file.write(piece)
        except httpx2.TransportError as error:
            raise StoreAwayError(str(error) or type(error).__name__) from error
