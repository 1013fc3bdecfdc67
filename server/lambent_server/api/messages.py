"""Bodies of the REST interface; those that mirror a message of `proto/` have its fields and defaults."""

from typing import Annotated, Any, Literal, Self

from lambent_core.layouts import LAYOUTS
from lambent_core.pictures import WHOLE, Name
from pydantic import BaseModel, ConfigDict, Field, computed_field

from lambent_server.api.parameters import Settings, SettingValue
from lambent_server.core.clock import rfc3339
from lambent_server.database.model import SceneState

# Without this the schema would allow names that match none of the patterns.
ONLY_THESE = {"additionalProperties": False}
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
LabelName = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,63}$")]
JobState = Literal["queued", "running", "cancelling", "retry_wait", "succeeded", "failed", "cancelled"]
NewJobKind = Literal["train", "check", "prepare", "bake"]
JobKind = Literal["train", "check", "prepare", "bake", "render", "batch"]


class Given(BaseModel):
    """A body that a client sends: unknown fields are refused, and no value is converted."""

    model_config = ConfigDict(extra="forbid", strict=True)


SizeBytes = Annotated[int, Field(ge=0, json_schema_extra={"format": "int64"})]
"""A size or position in bytes, below 2^53."""


class Shown(BaseModel):
    """A body that the server sends."""

    model_config = ConfigDict(extra="forbid")

    @classmethod
    def of(cls, row: object, **given: Any) -> Self:
        """Return the body of a row: columns of the same names, times as text, and what is given besides."""
        same = {name: getattr(row, name) for name in cls.model_fields.keys() - given if hasattr(row, name)}
        times = {name: rfc3339(at) for name, at in same.items() if name == "at" or name.endswith("_at")}
        return cls(**{**same, **times, **given})


class NewScene(Given):
    """A scene to upload files to."""

    name: Name
    labels: Annotated[
        dict[LabelName, SettingValue],
        Field(max_length=32, json_schema_extra=ONLY_THESE, default_factory=dict),
    ]


class PlannedFile(Given):
    """A file that the scene will have."""

    path: Annotated[str, Field(min_length=1, max_length=240)]
    size: Annotated[int, Field(ge=0, le=2**53), WHOLE]
    sha256: Sha256


class Scene(Shown):
    """A set of photographs."""

    id: str
    name: str
    state: SceneState
    layout: str | None
    created_at: str
    committed_at: str | None
    num_files: int
    size_bytes: SizeBytes
    content_sha256: str | None
    thumbnail_url: str | None
    """A small photograph of the scene; null before its first check."""
    labels: dict[str, str]


class SceneList(Shown):
    """One page of scenes, newest first."""

    items: list[Scene]
    next_cursor: str | None


class Finding(Shown):
    """Mirrors lambent_proto.v1.Finding."""

    code: str
    severity: Literal["", "warning", "error"]
    message: str
    subject: str


class SceneReport(Shown):
    """Mirrors lambent_proto.v1.SceneReport."""

    usable: bool
    layout: str
    findings: list[Finding]
    num_train_frames: int
    num_test_frames: int


class PictureFigures(Shown):
    """Mirrors lambent_proto.v1.PictureFigures."""

    light: str
    path: str
    clipped_share: float
    sharpness: float
    exposure_ev: float
    exposure_jump_ev: float


class ViewFigures(Shown):
    """Mirrors lambent_proto.v1.ViewFigures."""

    name: str
    split: Literal["", "train", "test"]
    azimuth_deg: float
    elevation_deg: float
    distance: float
    mask_share: float
    border_share: float
    unexplained_share: float
    missed_share: float
    carved_share: float
    hole_share: float
    speck_share: float
    num_specks: int
    moved_share: float
    mismatch_ev: float
    pictures: list[PictureFigures]


class CaptureFigures(Shown):
    """Mirrors lambent_proto.v1.CaptureFigures."""

    schema_version: str
    num_train_views: int
    gap_deg: float
    upper_gap_deg: float
    upper_gap_azimuth_deg: float
    upper_gap_elevation_deg: float
    lowest_elevation_deg: float
    highest_elevation_deg: float
    has_masks: bool
    has_hull: bool
    outside_box_share: float
    exposure_range_ev: float
    views: list[ViewFigures]
    lacks_cameras: bool = False


class SceneReportAnswer(SceneReport):
    """The report and the resulting state of the scene; `checked` is false before the first check."""

    scene_id: str
    state: SceneState
    checked: bool
    figures: CaptureFigures | None
    """Measurements of the capture; null if there are none, or before the scene has been checked."""

    @computed_field
    def layout_title(self) -> str:
        """The name of the layout for display, in English; empty before the scene has been checked."""
        return LAYOUTS[self.layout].title if self.layout in LAYOUTS else self.layout


class NewJob(Given):
    """A job to submit for a scene."""

    scene_id: Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")]
    preset: Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")] = "fast"
    params: Settings = {}
    gpus: Annotated[int, Field(ge=0, le=1024), WHOLE] | None = None
    priority: Annotated[int, Field(ge=-1000, le=1000), WHOLE] = 0
    labels: Annotated[dict[LabelName, SettingValue], Field(max_length=32, json_schema_extra=ONLY_THESE)] = {}
    kind: NewJobKind = "train"
    seed: Annotated[int, Field(ge=0, le=2**31 - 1), WHOLE] = 0

    webhook: Annotated[str, Field(min_length=1, max_length=2000)] | None = None
    """Where to tell that it has ended."""


class Progress(Shown):
    """Mirrors lambent_proto.v1.Progress."""

    stage: str
    step: int
    num_steps: int
    fraction: float
    eta_s: float
    steps_per_s: float
    loss: float
    psnr: float
    doing: str = ""


class JobError(Shown):
    """The reason why the last run failed."""

    code: str
    message: str
    cause: str
    run: int


class Job(Shown):
    """A job and its progress."""

    id: str
    kind: JobKind
    scene_id: str
    scene_name: str
    """Empty if the scene was deleted."""
    preset: str
    params: dict[str, str]
    gpus: int
    priority: int
    labels: dict[str, str]
    seed: int
    state: JobState
    run: int
    created_at: str
    started_at: str | None
    finished_at: str | None
    retry_at: str | None
    progress: Progress | None
    error: JobError | None
    bundle_id: str | None
    batch_id: str | None
    """The batch of which the job renders a part."""
    thumbnail_url: str | None
    """The picture of its bundle, or its newest preview, or the photograph of the scene; else null."""
    last_event: int
    webhook: str | None


class JobList(Shown):
    """One page of jobs, newest first."""

    items: list[Job]
    next_cursor: str | None


class Event(Shown):
    """Mirrors lambent_proto.v1.Event."""

    job_id: str
    seq: int
    at: str
    type: str
    run: int
    state: Literal["", JobState]
    progress: Progress | None
    message: str
    sha256: str
    name: str


class EventList(Shown):
    """Events of a job's history, in order."""

    items: list[Event]
    next_cursor: str | None


class Artifact(Shown):
    """A file that a job has produced, besides its bundle."""

    name: str
    sha256: Sha256
    size_bytes: SizeBytes
    media_type: str
    url: str


class ArtifactList(Shown):
    """The files that a job has produced."""

    items: list[Artifact]
    next_cursor: str | None


class Environment(Shown):
    """Light from all directions, as a latitude-longitude picture."""

    id: str
    name: str
    format: Literal["exr", "hdr"]
    width: int
    height: int
    sha256: Sha256
    size_bytes: SizeBytes
    created_at: str
    url: str


class EnvironmentList(Shown):
    """The environments of this tenant, newest first."""

    items: list[Environment]
    next_cursor: str | None


class Preset(Shown):
    """A named set of training settings."""

    name: str
    description: str
    gpus: int
    budget_s: float | None = None
    """Time budget of a job on the hardware that the preset is intended for; null if unknown."""


class PresetList(Shown):
    """The values that `preset` may have."""

    items: list[Preset]
    default: str


class NewEstimate(Given):
    """A job whose duration is to be estimated."""

    preset: Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")]


class Estimate(Shown):
    """The estimated duration of a job, from its start to its end."""

    preset: str
    seconds: float | None
    """The median of the measured jobs, else the preset's budget; null if there is neither."""
    shortest_s: float | None
    longest_s: float | None
    num_measured: int
    """Earlier jobs of this preset on this server that were measured; 0: the figures are the budget."""
    num_ahead: int
    """Unfinished jobs that may run first."""


class LoginCode(Given):
    """The code of a one-time link."""

    code: Annotated[str, Field(min_length=1, max_length=200)]


class LoginLink(Shown):
    """A link that logs one browser in, once."""

    url: str
    expires_at: str


class ProblemDetail(Shown):
    """One thing that is wrong with a request."""

    pointer: str
    message: str


class ProblemDocument(BaseModel):
    """An RFC 9457 problem document."""

    type: str
    title: str
    status: int
    code: str
    detail: str
    retryable: bool
    errors: list[ProblemDetail]
    request_id: str
    findings: list[Finding] | None = None
    quota: dict[str, Any] | None = None
