"""The objects that routes, worker service and controller share."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field

from lambent_server.api.fair_places import FairPlaces
from lambent_server.cluster.wakeups import Wakeups
from lambent_server.core.settings import Settings
from lambent_server.database.engine import Database
from lambent_server.database.latest_time import begin_time
from lambent_server.database.revision import require_released
from lambent_server.executors.local import count_gpus
from lambent_server.provenance import Signer, open_signer
from lambent_server.storage.disk_space import Space
from lambent_server.storage.s3 import S3Options
from lambent_server.storage.store import BlobStore


@dataclass(slots=True)
class Capacity:
    """What there is for runs; the executor, once there is one, replaces what the settings say."""

    max_gpus: Callable[[], int]
    """How many GPUs a single run can have."""
    num_places: Callable[[], int]
    """How many runs without GPUs there is room for, at least 1."""

    @classmethod
    def of_machine(cls, settings: Settings) -> "Capacity":
        """Return what this machine has, unless the settings say otherwise."""
        gpus = count_gpus() if settings.local_gpus is None else settings.local_gpus
        return cls(lambda: gpus, lambda: max(settings.local_slots, 1))


@dataclass(frozen=True, slots=True)
class Services:
    """The parts of one running server."""

    settings: Settings
    database: Database
    store: BlobStore
    wakeups: Wakeups
    capacity: Capacity
    decoders: FairPlaces = field(init=False)
    """Places of processes that decode uploads, in threads apart from those that answer requests."""
    space: Space = field(init=False)
    """What there is for the bodies of uploads."""
    signer: Signer | None = None
    """Signs where bundles are from; None in commands beside a server."""
    key_uses: dict[str, float] = field(default_factory=dict)
    """Times of the last use of keys that are not yet stored in the database."""

    def __post_init__(self) -> None:
        """Prepare what the requests and runs of this server share."""
        floor, share = self.settings.disk_floor_bytes, self.settings.tenant_share
        # The class is frozen.
        object.__setattr__(self, "decoders", FairPlaces.shared(self.settings.max_decoders, self.settings))
        object.__setattr__(self, "space", Space(self.free_bytes, floor_bytes=floor, tenant_share=share))

    def free_bytes(self) -> int:
        """Return the free space of the data folder."""
        return shutil.disk_usage(self.settings.data).free

    def require_disk(self) -> None:
        """Refuse requests that would fill the disk; running jobs are not affected."""
        self.space.require()


def open_services(settings: Settings) -> Services:
    """Create the folders, migrate the database and return the parts."""
    database = open_database(settings)
    for folder in (settings.data, settings.runs, settings.scratch):
        folder.mkdir(parents=True, exist_ok=True)
    # Uploads that were in progress when the last server ended.
    for path in settings.scratch.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    database.migrate()
    begin_time(database)
    capacity = Capacity.of_machine(settings)
    signer = open_signer(database, settings)
    store = _open_store(settings, database, s3_options(settings))
    return Services(settings, database, store, Wakeups(), capacity, signer)


def join_services(settings: Settings, database: Database, *, with_store: bool = True) -> Services:
    """Return the parts for a command that may run beside a server; nothing is created or migrated.

    Without `with_store`, a store in S3 is not asked whether it works.
    """
    store = _open_store(settings, database, s3_options(settings) if with_store else None)
    return Services(settings, database, store, Wakeups(), Capacity.of_machine(settings))


def open_database(settings: Settings) -> Database:
    """Return the database of the settings, as it is.

    Raises UnreleasedSchemaError, having changed nothing, or the driver's exception.
    """
    database = Database(settings.database_url, pooled=settings.database_direct is not None)
    place, option = f"the data folder {settings.data}", "--data"
    if settings.database is not None:
        place, option = f"the database {database.url.render_as_string()}", "--database"
    try:
        if (revision := database.revision()) is not None:
            require_released(revision, place, option)
    except BaseException:
        database.close()
        raise
    return database


def _open_store(settings: Settings, database: Database, s3: S3Options | None) -> BlobStore:
    store = BlobStore(settings.data / "store", settings.store, s3)
    store.checks.write = database.write
    return store


def s3_options(settings: Settings) -> S3Options | None:
    """Return where the bucket of a store in S3 is; None for other stores."""
    if settings.store is None or not settings.store.startswith("s3://"):
        return None
    return S3Options(
        url=settings.store,
        endpoint=settings.store_endpoint,
        public_endpoint=settings.store_public_endpoint,
        region=settings.store_region,
    )
