"""Bodies of the REST interface about the server itself."""

from typing import Literal

from pydantic import Field

from lambent_server.api.messages import Shown


class Quota(Shown):
    """What an organisation may use of something, and what it uses."""

    name: Literal["max_bytes", "max_queued_jobs", "max_gpu_minutes"]
    limit: int | float | None
    """Null: no limit. Bytes and jobs are whole numbers."""
    used: int | float
    """Of GPU minutes: those of this month (UTC), and those promised to unfinished jobs."""


class Limits(Shown):
    """The limits of what the server accepts."""

    max_json_bytes: int
    max_scene_bytes: int
    max_scene_files: int
    max_archive_ratio: float
    max_environment_bytes: int
    max_environment_pixels: int
    max_queued_jobs: int
    max_batch_pictures: int
    max_gpus: int
    max_wait_s: float
    scene_suffixes: list[str]
    quotas: list[Quota]
    """Of this organisation."""


class Notice(Shown):
    """A notice of the operators."""

    since: str
    message: str


class Notices(Shown):
    """Notices of the operators; null where there is none."""

    drain: Notice | None
    """No run starts; running ones continue."""
    maintenance: Notice | None
    """Changes are refused with 503; reading works."""


class Version(Shown):
    """The version of this server."""

    name: Literal["lambent"]
    version: str
    api: Literal["v1"]
    sign_in_url: str | None
    """Where people sign in with their browsers; null if that is not set up."""


class Health(Shown):
    """Whether the server is alive, and the state of its parts."""

    status: Literal["ok", "unavailable"]
    checks: dict[str, str] = Field(default_factory=dict)
