"""Files that go directly to the store of a server, by addresses that the server signs for each of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

from lambent.connection import Connection, pause_s
from lambent.errors import (
    DigestMismatchError,
    LambentError,
    RefusedError,
    ServerFaultError,
    UnreachableError,
)

BATCH = 50
"""Files whose addresses are requested at a time: they are valid for a while only."""
PATIENCE_S = 300.0
"""How long a server or a store that does not answer is waited for."""
MAX_TRIES = 5
"""How often a file is sent that the store does not take."""
Result = TypeVar("Result")


class NoWayError(Exception):
    """The store was never reached from here: the server has to carry the bytes."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LocalFile:
    """A file to send."""

    path: Path
    sha256: str
    size_bytes: int


def is_away(error: LambentError) -> bool:
    """Return whether an error says that the server, or its store, is unavailable for now."""
    if isinstance(error, ServerFaultError):
        return error.status in (502, 503, 504)
    return isinstance(error, UnreachableError)


def is_store_away(error: LambentError) -> bool:
    """Return whether an error says that a server answers, but its store is unavailable."""
    return error.code == "store_unavailable"


def patiently(
    connection: Connection,
    action: Callable[[], Result],
    passes: Callable[[LambentError], bool] = is_away,
) -> Result:
    """Return the result of an action that is repeated after errors that pass, for `PATIENCE_S` at most."""
    waited_s = 0.0
    for attempt in count(1):
        try:
            return action()
        except LambentError as error:
            if not passes(error) or waited_s >= PATIENCE_S:
                raise
        seconds = pause_s(attempt)
        waited_s += seconds
        connection.sleep(seconds)
    raise AssertionError("the loop above returns or raises")


class DirectSender:
    """Sends files of one scene to the store."""

    def __init__(self, connection: Connection, scene_id: str, advance: Callable[[int], None]) -> None:
        self._connection = connection
        self._path = f"/v1/scenes/{scene_id}"
        self._advance = advance
        self._reached = False

    def send(self, files: Sequence[LocalFile], offers: Sequence[Mapping[str, Any]]) -> list[LocalFile]:
        """Send files for which the server has addresses, and return the others.

        `offers` are those that came with the plan. What was sent before is not sent again. Raises
        `NoWayError`, and `store.unreachable` when the store stays away for `PATIENCE_S`.
        """
        first = {str(offer["sha256"]): offer for offer in offers}
        left: list[LocalFile] = []
        for start in range(0, len(files), BATCH):
            batch = files[start : start + BATCH]
            known = {file.sha256: first[file.sha256] for file in batch if file.sha256 in first}
            left += self._send_batch({file.sha256: file for file in batch}, known)
        return left

    def _send_batch(
        self, files: dict[str, LocalFile], offers: Mapping[str, Mapping[str, Any]]
    ) -> list[LocalFile]:
        """Send some files; return those that the store does not take at all."""
        waiting, left = dict(files), []
        for attempt in count(1):
            if len(offers) < len(waiting):
                offers = self._offers(waiting)
            left += [waiting.pop(sha256) for sha256 in [*waiting] if sha256 not in offers]
            if not waiting:
                return left
            for sha256, file in waiting.items():
                self._send_file(file, offers[sha256])
            answer = self._patiently("complete", {"sha256": [*waiting]})
            for sha256 in answer["stored"]:
                del waiting[sha256]
            for refused in answer["refused"]:
                if attempt >= MAX_TRIES:
                    raise RefusedError(409, refused)
            offers = {}
        raise AssertionError("the loop above returns or raises")

    def _offers(self, files: Mapping[str, LocalFile]) -> dict[str, Mapping[str, Any]]:
        answer = self._patiently("uploads", {"sha256": [*files]})
        return {str(offer["sha256"]): offer for offer in answer["items"]}

    def _patiently(self, what: str, body: Mapping[str, Any]) -> Any:
        """Return the answer of the server; waits while it, or its store, is unavailable."""

        def ask() -> Any:
            return self._connection.json("POST", f"{self._path}/files:{what}", json=body, repeatable=True)

        return patiently(self._connection, ask)

    def _send_file(self, file: LocalFile, offer: Mapping[str, Any]) -> None:
        """Send what an offer asks for; addresses that do not work any more are left to the next offer."""
        for part in offer["parts"]:
            size = int(part["size_bytes"])

            def put(part: Mapping[str, Any] = part, size: int = size) -> int:
                return self._put(file, part, size)

            status = patiently(self._connection, put)
            if status == 400:
                raise DigestMismatchError(
                    "scene.file_changed",
                    f"{file.path.name} was changed while it was being sent",
                    "send the scene again",
                )
            if status >= 300:
                return
            self._advance(size)

    def _put(self, file: LocalFile, part: Mapping[str, Any], size: int) -> int:
        try:
            status = self._connection.put_to_store(
                part["url"], part["headers"], file.path, int(part["offset"]), size
            )
        except UnreachableError as error:
            if not self._reached:
                raise NoWayError from error
            raise
        self._reached = True
        if status in (429, 500, 502, 503, 504):
            raise UnreachableError(
                "store.unreachable", f"the store answers with {status}", "try again in some minutes"
            )
        if status >= 300 and status not in (400, 403, 404):
            raise LambentError(
                "store.refused", f"the store answers with {status}", "tell the server's operator"
            )
        return status
