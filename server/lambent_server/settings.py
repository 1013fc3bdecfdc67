"""Settings of a server, from the environment (`LAMBENT_…`) or the command line.

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
    """The complete configuration of one server, including every timeout, so that tests can shorten them."""

    model_config = SettingsConfigDict(env_prefix="LAMBENT_", frozen=True, extra="ignore")

    data: Path = Field(default_factory=lambda: Path(user_data_dir("lambent")))
    """Folder for the database, the blobs, the key and the run folders."""
    host: str = "127.0.0.1"
    port: int = Field(default=8420, ge=0, le=65535)
    """0 selects any free port."""
    insecure: bool = False
    """Allow an address that other machines can reach, without TLS."""
    allowed_hosts: Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)] = ()
    """Host names that the server accepts besides the loopback ones, separated by commas."""
    database: str | None = None
    """SQLAlchemy URL; default: a SQLite file in the data folder."""
    store: str | None = None
    """URL of the blob store; default: a folder in the data folder."""
    executor: Literal["local"] = "local"
    run_command: tuple[str, ...] = (sys.executable, "-m", "lambent_worker", "run")
    """Command with which the local executor starts a run process."""
    run_environment: Annotated[tuple[str, ...], NoDecode, BeforeValidator(_split)] = ()
    """Variables that run processes get besides the usual ones; `HF_*` stands for all with this prefix."""
    run_memory_bytes: Size | None = None
    """Memory that one run process may allocate (Linux), 0 for no limit; default: nine tenths of the memory
    divided by `local_slots`."""
    run_give_up_after_s: Seconds = 24 * 3600.0
    """Time without a server after which a run process exits."""

    local_slots: int = Field(default=1, ge=1)
    """Jobs that run on this machine at the same time."""
    local_gpus: int | None = Field(default=None, ge=0)
    """GPUs that the local executor assigns; default: the number of device files."""

    tick_s: Seconds = 0.5
    """How often the controller compares rows with processes."""
    heartbeat_s: Seconds = 10.0
    lost_after_s: Seconds = 60.0
    """Time without a heartbeat after which a run that cannot be found is lost."""
    stall_after_s: Seconds = 900.0
    """Time without a step after which a run is stopped and retried."""
    stage_stall_after_s: dict[str, float] = {}
    """The same for individual tasks."""
    stop_grace_s: Seconds = 30.0
    """Time between SIGTERM and SIGKILL."""
    shutdown_grace_s: Seconds = 8.0
    """Time for open streams, and on Ctrl-C for run processes, to end when the server stops."""
    retry_delay_s: float = Field(default=5.0, ge=0)
    """Wait before the first retry after a failure; doubles with every further one."""
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
    """Window over which a body must average `body_bytes_per_s`."""
    body_bytes_per_s: float = Field(default=1.0 * KIB, ge=0)
    max_connections: int = Field(default=4096, ge=16)
    """Simultaneous connections; fewer if the system allows fewer open files."""
    max_streams: int = Field(default=2000, ge=1)
    """Simultaneous event streams of one tenant."""
    login_code_s: Seconds = 3600.0
    session_s: Seconds = 30 * 24 * 3600.0
    idempotency_s: Seconds = 7 * 24 * 3600.0
    garbage_after_s: Seconds = 60.0
    """Time for which an unreferenced blob is kept."""
    orphan_after_s: Seconds = 24 * 3600.0
    """Age at which bytes without a row, and folders of interrupted uploads, are removed."""
    reconcile_s: Seconds = 3600.0
    """Interval at which rows and files are compared."""
    open_scene_s: Seconds = 7 * 24 * 3600.0
    """Time for which an uncommitted upload is kept."""

    max_json_bytes: Size = MIB
    max_plan_bytes: Size = 8 * MIB
    max_scene_bytes: Size = 4 * GIB
    max_scene_files: int = Field(default=20_000, ge=1)
    max_archive_ratio: float = Field(default=200.0, gt=1)
    max_environment_bytes: Size = 512 * MIB
    max_environment_pixels: int = Field(default=16384 * 8192, ge=1)
    max_queued_jobs: int = Field(default=1000, ge=1)
    """Unfinished jobs of one tenant."""
    max_batch_pictures: int = Field(default=1000, ge=1)
    """Pictures of one order."""
    disk_floor_bytes: Size = GIB
    """Free space below which uploads and new jobs are refused."""

    log_json: bool | None = None
    """Log JSON lines; default: unless standard error is a terminal."""

    @property
    def database_url(self) -> str:
        """Return the SQLAlchemy URL in effect."""
        if self.database is None:
            return f"sqlite:///{self.data / 'lambent.sqlite'}"
        return self.database.replace("postgresql://", "postgresql+psycopg://", 1)

    @property
    def runs(self) -> Path:
        """Return the folder that contains a folder per job."""
        return self.data / "runs"

    @property
    def scratch(self) -> Path:
        """Return the folder of uploads in progress."""
        return self.data / "scratch"

    def stall_limit(self, stage: str) -> float:
        """Return the time in seconds that a step of the task `stage` may take."""
        return self.stage_stall_after_s.get(stage, self.stall_after_s)
