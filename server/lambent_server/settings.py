"""Everything about a server that can be set, by environment (`LAMBENT_…`) or command line.

Times are in seconds, sizes in bytes.
"""

import sys
from pathlib import Path
from typing import Annotated, Any, Literal

from platformdirs import user_data_dir
from pydantic import BeforeValidator, Field
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

Seconds = Annotated[float, Field(gt=0)]
Size = Annotated[int, Field(ge=0)]

KIB = 1024
MIB = 1024 * KIB
GIB = 1024 * MIB


def _split(value: Any) -> Any:
    """Return the parts of "a, b"."""
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


class Settings(BaseSettings):
    """The whole configuration of one server; every time-out is here, so that tests can shorten it."""

    model_config = SettingsConfigDict(env_prefix="LAMBENT_", frozen=True, extra="ignore")

    data: Path = Field(default_factory=lambda: Path(user_data_dir("lambent")))
    """Folder of the database, the blobs, the key and the run folders."""
    host: str = "127.0.0.1"
    port: int = Field(default=8420, ge=0, le=65535)
    """0 takes any free port."""
    insecure: bool = False
    """Allow an address that other machines can reach, without TLS."""
    allowed_hosts: Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)] = ()
    """Names besides the loopback ones under which the server may be addressed, with commas between them."""
    database: str | None = None
    """SQLAlchemy URL; a SQLite file in the data folder where none is given."""
    store: str | None = None
    """URL of the blob store; a folder in the data folder where none is given."""
    executor: Literal["local"] = "local"
    run_command: tuple[str, ...] = (sys.executable, "-m", "lambent_worker", "run")
    """How the local executor starts a run process."""
    run_environment: Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)] = ()
    """Variables of the server that run processes get besides the usual ones; `HF_*` is all that begin so."""
    run_memory_bytes: Size | None = None
    """What one run process may allocate (Linux), 0 for any amount; where not given, nine tenths of the memory
    shared by `local_slots`."""
    run_give_up_after_s: Seconds = 24 * 3600.0
    """Time without a server after which a run process ends itself."""

    local_slots: int = Field(default=1, ge=1)
    """Jobs that run on this machine at the same time."""
    local_gpus: int | None = Field(default=None, ge=0)
    """GPUs the local executor hands out; counted from the device files where not given."""

    tick_s: Seconds = 0.5
    """How often the controller compares rows with processes."""
    heartbeat_s: Seconds = 10.0
    lost_after_s: Seconds = 60.0
    """Silence after which a run that cannot be found is lost."""
    stall_after_s: Seconds = 900.0
    """Time without a step after which a run is stopped and tried again."""
    stage_stall_after_s: dict[str, float] = {}
    """The same for single stages."""
    stop_grace_s: Seconds = 30.0
    """Time between SIGTERM and SIGKILL."""
    shutdown_grace_s: Seconds = 8.0
    """Time the server gives open streams, and on Ctrl-C its run processes, to end."""
    retry_delay_s: float = Field(default=5.0, ge=0)
    """Wait before the second try after a failure; doubles with every further one."""
    max_failures: int = Field(default=3, ge=1)
    max_losses: int = Field(default=20, ge=0)
    max_losses_without_checkpoint: int = Field(default=3, ge=1)
    progress_interval_s: Seconds = 1.0
    preview_interval_s: Seconds = 10.0

    stream_ping_s: Seconds = 15.0
    stream_poll_s: Seconds = 1.0
    max_wait_s: Seconds = 60.0
    header_timeout_s: Seconds = 5.0
    body_window_s: Seconds = 30.0
    """A body must bring `body_bytes_per_s` over every such window."""
    body_bytes_per_s: float = Field(default=1.0 * KIB, ge=0)
    max_connections: int = Field(default=4096, ge=16)
    """Connections at the same time; fewer where the system allows fewer open files."""
    max_streams: int = Field(default=2000, ge=1)
    """Event streams of one tenant at the same time."""
    login_code_s: Seconds = 3600.0
    session_s: Seconds = 30 * 24 * 3600.0
    idempotency_s: Seconds = 7 * 24 * 3600.0
    garbage_after_s: Seconds = 60.0
    """How long a blob that nothing refers to any more is kept."""
    orphan_after_s: Seconds = 24 * 3600.0
    """Age at which bytes that no row names, and folders of uploads that broke off, are removed."""
    reconcile_s: Seconds = 3600.0
    """How often rows and files are compared."""
    open_scene_s: Seconds = 7 * 24 * 3600.0
    """How long an upload that was never committed is kept."""

    max_json_bytes: Size = MIB
    max_plan_bytes: Size = 8 * MIB
    max_scene_bytes: Size = 4 * GIB
    max_scene_files: int = Field(default=20_000, ge=1)
    max_archive_ratio: float = Field(default=200.0, gt=1)
    max_environment_bytes: Size = 512 * MIB
    max_environment_pixels: int = Field(default=16384 * 8192, ge=1)
    max_queued_jobs: int = Field(default=1000, ge=1)
    """Jobs of one tenant that have not ended."""
    max_batch_pictures: int = Field(default=1000, ge=1)
    """Pictures of one order."""
    disk_floor_bytes: Size = GIB
    """Free space below which uploads and new jobs are refused."""

    log_json: bool | None = None
    """JSON lines; where not given, if standard error is no terminal."""

    @property
    def database_url(self) -> str:
        """Return the SQLAlchemy URL in effect."""
        if self.database is None:
            return f"sqlite:///{self.data / 'lambent.sqlite'}"
        return self.database.replace("postgresql://", "postgresql+psycopg://", 1)

    @property
    def runs(self) -> Path:
        """Return the folder that holds one folder for each job."""
        return self.data / "runs"

    @property
    def scratch(self) -> Path:
        """Return the folder of uploads in flight."""
        return self.data / "scratch"

    def stall_limit(self, stage: str) -> float:
        """Return the time in seconds that `stage` may take for one step."""
        return self.stage_stall_after_s.get(stage, self.stall_after_s)
