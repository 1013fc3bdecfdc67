"""The objects that routes, worker service and controller share."""

import shutil
from dataclasses import dataclass, field

from lambent_server.database.engine import Database
from lambent_server.problems import Problem
from lambent_server.settings import Settings
from lambent_server.store import BlobStore
from lambent_server.wakeups import Wakeups


@dataclass(frozen=True, slots=True)
class Services:
    """The parts of one running server."""

    settings: Settings
    database: Database
    store: BlobStore
    wakeups: Wakeups
    local_gpus: int
    key_uses: dict[str, float] = field(default_factory=dict)
    """Times of the last use of keys that are not yet stored in the database."""

    def require_disk(self) -> None:
        """Refuse requests that would fill the disk; running jobs are not affected."""
        free = shutil.disk_usage(self.settings.data).free
        if free < self.settings.disk_floor_bytes:
            raise Problem(
                507,
                "disk_floor",
                f"{free} bytes are free, but {self.settings.disk_floor_bytes} must stay free; "
                "delete scenes or add disk space",
                retryable=True,
            )


def open_services(settings: Settings) -> Services:
    """Create the folders, migrate the database and return the parts."""
    from .executors.local import count_gpus

    for folder in (settings.data, settings.runs, settings.scratch):
        folder.mkdir(parents=True, exist_ok=True)
    # Uploads that were in progress when an earlier server stopped.
    for path in settings.scratch.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    database = Database(settings.database_url)
    database.migrate()
    store = BlobStore(settings.data / "store", settings.store)
    gpus = count_gpus() if settings.local_gpus is None else settings.local_gpus
    return Services(settings, database, store, Wakeups(), gpus)
