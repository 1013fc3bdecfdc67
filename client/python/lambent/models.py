"""The server's JSON as frozen dataclasses, field for field.

Unknown fields are ignored and unknown states are not final, so that an older client reads a newer server.
Times are RFC 3339 strings in UTC, sizes bytes, durations seconds.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Self

from lambent.errors import LambentError

FINAL_STATES = frozenset({"succeeded", "failed", "cancelled"})
"""Job states that never change again."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class _Message:
    """A JSON object with the dataclass's fields; those without a default are required."""

    def __repr__(self) -> str:
        """Return the fields that are set, in one line."""
        return short_repr(self)

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Self:
        """Return the object, or raise `client.unexpected_answer` when required fields are missing."""
        known = {entry.name for entry in fields(cls)}
        given = {
            name: _READERS[name](value) if name in _READERS else value
            for name, value in data.items()
            if name in known and value not in (None, {})
        }
        try:
            return cls(**given)
        except TypeError as error:
            raise LambentError(
                "client.unexpected_answer",
                f"the server's {cls.__name__.lower()} object lacks something: {error}",
                "check that client and server have the same version (`lambent doctor`)",
            ) from error


_SHOWN = 48


def short_repr(message: Any) -> str:
    """Return the class and those fields of a dataclass that are set; long values are cut short."""
    shown = []
    for entry in fields(message):
        value = getattr(message, entry.name)
        if not value or value == Progress():
            continue
        text = repr(value)
        if isinstance(value, tuple):
            text = f"({len(value)} of them)"
        elif not isinstance(value, _Message) and len(text) > _SHOWN:
            text = f"{text[: _SHOWN - 3]}..."
        shown.append(f"{entry.name}={text}")
    return f"{type(message).__name__}({', '.join(shown)})"


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Progress(_Message):
    """How far a run is; fields that do not apply to the stage are zero. `psnr` in dB on training pixels."""

    stage: str = ""
    step: int = 0
    num_steps: int = 0
    fraction: float = 0.0
    eta_s: float = 0.0
    steps_per_s: float = 0.0
    loss: float = 0.0
    psnr: float = 0.0
    doing: str = ""
    """What the steps are of, where a task does several things: "matching pairs"."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class JobError(_Message):
    """Why a job failed."""

    code: str = ""
    message: str = ""
    cause: str = ""
    run: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Job(_Message):
    """One job. `run` counts its starts, `last_event` its events; `bundle_id` is set once it has succeeded."""

    id: str
    state: str
    scene_id: str = ""
    preset: str = ""
    params: Mapping[str, str] = field(default_factory=dict)
    run: int = 0
    created_at: str = ""
    started_at: str = ""
    finished_at: str = ""
    progress: Progress = Progress()
    error: JobError | None = None
    bundle_id: str = ""
    batch_id: str = ""
    """The batch that the job makes a part of."""
    labels: Mapping[str, str] = field(default_factory=dict)
    priority: int = 0
    kind: str = "train"
    seed: int = 0
    gpus: int = 0
    last_event: int = 0
    webhook: str = ""

    @property
    def is_final(self) -> bool:
        """Whether the job's state will never change again."""
        return self.state in FINAL_STATES


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Event(_Message):
    """One line of a job's history; `seq` counts from 1 inside the job.

    `type` is "state", "progress", "preview", "log", "checkpoint", "artifact" or "finding".
    """

    job_id: str
    seq: int = 0
    type: str
    at: str = ""
    run: int = 0
    state: str = ""
    progress: Progress = Progress()
    message: str = ""
    sha256: str = ""
    name: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Artifact(_Message):
    """A published file of a job; `url` is relative to the server."""

    name: str
    sha256: str
    size_bytes: int = 0
    media_type: str = "application/octet-stream"
    url: str = ""
    job_id: str = ""
    """Set where files of several jobs are listed."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Environment(_Message):
    """An environment map on the server."""

    id: str
    name: str = ""
    format: str = ""
    width: int = 0
    height: int = 0
    sha256: str = ""
    size_bytes: int = 0
    created_at: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Batch(_Message):
    """Pictures that are made by several jobs; `state` is that of all of them together."""

    id: str
    state: str
    name: str = ""
    created_at: str = ""
    num_pictures: int = 0
    num_done: int = 0
    num_failed: int = 0
    job_ids: tuple[str, ...] = ()

    @property
    def is_final(self) -> bool:
        """Whether every job has ended; a retry can start some again."""
        return self.state in FINAL_STATES


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Share(_Message):
    """A link to one bundle; its fragment is the secret."""

    id: str
    bundle_id: str
    url: str
    created_at: str = ""
    expires_at: str = ""
    frame_ancestors: tuple[str, ...] = ()
    """Origins whose pages may show the bundle."""

    @property
    def snippet(self) -> str:
        """HTML that shows the bundle in a page of these origins."""
        return (
            f'<iframe src="{self.url}" title="Relightable object" width="640" height="480" '
            'style="border:0" loading="lazy" allow="fullscreen"></iframe>'
        )


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Webhook(_Message):
    """A subscription to changes of jobs; `secret` is set where it was just made or replaced."""

    id: str
    url: str
    name: str = ""
    events: tuple[str, ...] = ()
    labels: Mapping[str, str] = field(default_factory=dict)
    enabled: bool = True
    disabled_reason: str = ""
    """Why: "gone", the receiver answered 410; "asked", by a request; "maker_left", its maker has left."""
    created_at: str = ""
    secret: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Delivery(_Message):
    """A message to a receiver. `state` is "pending", "delivered" or "failed"; `id` is its `webhook-id`."""

    id: str
    state: str
    event: str = ""
    webhook_id: str = ""
    job_id: str = ""
    url: str = ""
    created_at: str = ""
    next_at: str = ""
    ended_at: str = ""
    num_attempts: int = 0
    attempts: tuple[Mapping[str, Any], ...] = ()
    """The newest: `at`, `status` (None without an answer), `error` and `seconds`."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Finding(_Message):
    """One thing about a scene: `severity` is "warning" or "error", `subject` a frame or file."""

    code: str
    message: str
    severity: str = ""
    subject: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class SceneReport(_Message):
    """The findings about a scene; none yet while `checked` is false."""

    scene_id: str
    state: str = ""
    checked: bool = False
    usable: bool = False
    layout: str = ""
    findings: tuple[Finding, ...] = ()
    num_train_frames: int = 0
    num_test_frames: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Scene(_Message):
    """A set of photographs on the server. `state` is "open", "uploaded", "ready" or "rejected".

    `content_sha256` is equal for scenes with equal paths and bytes.
    """

    id: str
    state: str = ""
    name: str = ""
    created_at: str = ""
    num_files: int = 0
    size_bytes: int = 0
    content_sha256: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    """Files of the pushed folder that have no place in a scene; known to the push only."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FileEntry:
    """A file of a scene or bundle: its path inside the folder (forward slashes), bytes and SHA-256."""

    path: str
    size_bytes: int
    sha256: str


_READERS: Mapping[str, Callable[[Any], Any]] = {
    "progress": Progress.from_json,
    "error": JobError.from_json,
    "seq": int,
    "findings": lambda items: tuple(map(Finding.from_json, items)),
    "job_ids": tuple,
    "events": tuple,
    "attempts": tuple,
    "frame_ancestors": tuple,
}
"""How the values of these fields are read, in every message."""
