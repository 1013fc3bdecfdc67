"""The calls of a client about batches of pictures."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from lambent import arguments, pictures
from lambent import fetch as fetching
from lambent.connection import Connection
from lambent.models import Artifact, Batch
from lambent.waiting import T, Wait


def _batch(batch_id: str) -> str:
    return f"/v1/batches/{arguments.identifier(batch_id, 'batch_id')}"


class BatchCalls:
    """The part of `Client` for batches."""

    _connection: Connection
    _sleep: Callable[[float], None]
    _clock: Callable[[], float]

    def _until_final(
        self, read: Callable[[float], T], timeout_s: float | None, progress: Callable[[T], None] | None
    ) -> T:
        """Return what `read` returns once that is final."""
        return Wait(
            read=read,
            timeout_s=None if timeout_s is None else arguments.seconds(timeout_s, "timeout_s"),
            progress=None if progress is None else arguments.function(progress, "progress"),
            sleep=self._sleep,
            clock=self._clock,
        ).until_final()

    def submit_batch(self, order: Mapping[str, Any], *, idempotency_key: str = "") -> Batch:
        """Queue a batch (the body of `POST /v1/batches`); the same `idempotency_key` makes one only."""
        return Batch.from_json(
            pictures.post(self._connection, "/v1/batches", arguments.mapping(order, "order"), idempotency_key)
        )

    def batch(self, batch_id: str) -> Batch:
        """Return a batch."""
        return Batch.from_json(self._connection.json("GET", _batch(batch_id)))

    def batches(self) -> Iterator[Batch]:
        """Return batches, newest first."""
        return map(Batch.from_json, self._connection.pages("/v1/batches"))

    def wait_batch(
        self,
        batch_id: str,
        *,
        timeout_s: float | None = None,
        progress: Callable[[Batch], None] | None = None,
    ) -> Batch:
        """Return the batch once every job of it has ended; the arguments are those of `wait`."""
        return self._until_final(lambda _within_s: self.batch(batch_id), timeout_s, progress)

    def cancel_batch(self, batch_id: str) -> Batch:
        """Ask for every job of a batch to be stopped."""
        path = _batch(batch_id) + ":cancel"
        return Batch.from_json(self._connection.json("POST", path, repeatable=True))

    def retry_batch(self, batch_id: str) -> Batch:
        """Queue the parts of a batch that failed or were cancelled again; the batch keeps its id."""
        return Batch.from_json(self._connection.json("POST", _batch(batch_id) + ":retry"))

    def batch_artifacts(self, batch_id: str) -> list[Artifact]:
        """Return the files that the jobs of a batch have published."""
        path = _batch(batch_id) + "/artifacts"
        return [Artifact.from_json(item) for item in self._connection.pages(path)]

    def fetch_batch(self, batch_id: str, target: str | Path) -> list[Path]:
        """Write the pictures, the table and the contact sheets of a batch into the folder `target`.

        Returns their paths. Files that exist with the same bytes are kept. The table and the sheets come
        last: a batch that has not ended has none yet.
        """
        files = pictures.for_people(self.batch_artifacts(batch_id))
        return fetching.download_all(self._connection, files, arguments.file_path(target, "target"))
