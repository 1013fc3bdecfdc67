"""Rows: one class for each table, which `rows.table` makes from it. Times are Unix seconds."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from sqlalchemy import JSON, BigInteger, Integer

Number = Annotated[int, BigInteger().with_variant(Integer, "sqlite")]
JsonText = Annotated[str, JSON()]
SceneState = Literal["open", "uploaded", "ready", "rejected"]


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyRow:
    """A key for programs."""

    id: str
    tenant_id: str
    name: str
    key_sha256: str
    created_at: float
    expires_at: float | None
    revoked_at: float | None
    last_used_at: float | None
    scopes: str | None
    """Separated by spaces; null: all of them."""
    user_id: str | None
    """Whose key it is; null: it belongs to no user."""
    maker_user_id: str | None
    maker_key_id: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneRow:
    """A scene."""

    id: str
    tenant_id: str
    name: str
    state: SceneState
    """Open: being uploaded. Ready: checked and usable."""
    layout: str | None
    created_at: float
    committed_at: float | None
    content_sha256: str | None
    num_files: int
    size_bytes: float
    report: dict[str, Any] | None
    """SceneReport as REST shows it."""
    thumbnail_sha256: str | None
    """One of its photographs, small."""
    labels: dict[str, str] | None


@dataclass(frozen=True, kw_only=True, slots=True)
class SceneFileRow:
    """A planned file of a scene."""

    scene_id: str
    path: str
    tenant_id: str
    sha256: str
    size_bytes: float


@dataclass(frozen=True, kw_only=True, slots=True)
class FiguresRow:
    """Measurements of a scene."""

    scene_id: str
    tenant_id: str
    figures: dict[str, Any]
    """CaptureFigures as REST shows them."""
    sha256: str
    """The page that shows them; empty if there is none."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JobRow:
    """A job."""

    id: str
    tenant_id: str
    kind: str
    scene_id: str
    preset: str
    params: dict[str, Any]
    gpus: int
    priority: int
    labels: dict[str, str]
    seed: int
    state: str
    run: int
    """The fence: counts the starts."""
    created_at: float
    updated_at: float
    started_at: float | None
    finished_at: float | None
    progress: dict[str, Any] | None
    error: dict[str, Any] | None
    bundle_id: str | None
    failures: int
    losses: int
    losses_without_checkpoint: int
    adjustments: dict[str, dict[str, float]]
    """What the next run does differently: factors by stage and setting."""
    retry_at: float | None
    stop_reason: str | None
    """Why the controller ends the run: cancel, stall, or ended (its run has said so)."""
    stop_at: float | None
    handle: dict[str, Any] | None
    """The executor's handle of the process; null if there is none."""
    run_started_at: float | None
    heartbeat_at: float | None
    progress_at: float | None
    progress_event_at: float | None
    event_seq: int
    report_seq: int
    order_id: str | None
    """The order of pictures and the part of it that the job renders; null for other kinds."""
    shard: int | None
    preview_sha256: str | None
    """The newest preview but for the sheet of an evaluation; its event holds the blob."""
    webhook: str | None
    """Where its end is reported."""
    maker_user_id: str | None
    maker_key_id: str | None
    gpu_s_reserved: float | None
    """What counts against the GPU minutes of its tenant until it has ended, at least."""

    @property
    def part(self) -> tuple[str, int]:
        """The order of pictures and the part of it that the job renders; jobs of other kinds have none."""
        assert self.order_id is not None
        assert self.shard is not None
        return self.order_id, self.shard


@dataclass(frozen=True, kw_only=True, slots=True)
class OrderRow:
    """An order of pictures, which jobs render."""

    id: str
    tenant_id: str
    kind: str
    """render or batch"""
    name: str
    spec: dict[str, Any]
    """RenderSpec as REST accepts it, with the names of its environments filled in."""
    num_pictures: int
    num_shards: int
    created_at: float


@dataclass(frozen=True, kw_only=True, slots=True)
class EventRow:
    """An event of a job's history."""

    job_id: str
    seq: int
    tenant_id: str
    at: float
    type: str
    run: int
    state: str
    progress: dict[str, Any] | None
    message: str
    sha256: str
    name: str


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckpointRow:
    """A checkpoint of a job."""

    id: str
    tenant_id: str
    job_id: str
    run: int
    stage: str
    step: int
    created_at: float
    number: Number
    """The order in which they were committed, whatever clocks say."""
    manifest: JsonText
    scene_id: str | None
    """The scene that it is kept with; null if it goes with the job."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ArtifactRow:
    """A file that a job has published besides its bundle."""

    job_id: str
    name: str
    tenant_id: str
    sha256: str
    size_bytes: float
    media_type: str


@dataclass(frozen=True, kw_only=True, slots=True)
class BundleRow:
    """A bundle."""

    id: str
    tenant_id: str
    job_id: str
    scene_id: str
    created_at: float
    labels: dict[str, str] | None


@dataclass(frozen=True, kw_only=True, slots=True)
class BundleFileRow:
    """A file of a bundle."""

    bundle_id: str
    path: str
    tenant_id: str
    sha256: str
    size_bytes: float
    media_type: str
    gzip_bytes: float | None
    """Size of the compressed copy; 0 if it saves too little, -1 if the file is gone, None if unknown."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ShareRow:
    """A link that gives everyone who has it read access to a bundle."""

    id: str
    tenant_id: str
    bundle_id: str
    created_at: float
    expires_at: float
    revoked_at: float | None
    frame_ancestors: str | None
    """Origins whose pages may show the bundle, separated by spaces; none if it is null."""
    maker_user_id: str | None
    maker_key_id: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class EnvironmentRow:
    """An environment map."""

    id: str
    tenant_id: str
    name: str
    format: str
    width: int
    height: int
    sha256: str
    size_bytes: float
    created_at: float


@dataclass(frozen=True, kw_only=True, slots=True)
class WebhookRow:
    """A standing subscription to changes of jobs."""

    id: str
    tenant_id: str
    name: str
    url: str
    events: list[str]
    """Types of events, such as "job.succeeded"."""
    labels: dict[str, str]
    """Labels that a job must have."""
    secret: str
    previous_secret: str | None
    """Signs too, until that time."""
    previous_until: float | None
    created_at: float
    disabled_at: float | None
    disabled_reason: str
    """gone (the receiver said so), asked (a person did), maker_left (whoever made it has left)"""
    maker_user_id: str | None
    maker_key_id: str | None


@dataclass(frozen=True, kw_only=True, slots=True)
class SecretRow:
    """What signs the deliveries that jobs ask for themselves."""

    tenant_id: str
    secret: str
    previous_secret: str | None
    previous_until: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class DeliveryRow:
    """An entry of the outbox, written together with the change that it tells."""

    id: str
    """The receiver's key against duplicates."""
    tenant_id: str
    webhook_id: str | None
    """Null if the job asked for it."""
    job_id: str | None
    """Null for a ping."""
    event: str
    url: str
    host: str
    """Host and port, for the limit of simultaneous deliveries."""
    body: str
    """The bytes to send, the same at every attempt."""
    state: str
    """pending, delivered, failed"""
    created_at: float
    since: float
    """When the attempts began: those of a repeat count anew."""
    next_at: float | None
    """When the next attempt is due; null if there is none."""
    claim: str | None
    """Who is making the attempt now; `next_at` is when others may assume that it was lost."""
    num_attempts: int
    attempts: list[dict[str, Any]]
    """The newest attempts: {"at", "status", "error", "seconds"}."""
    ended_at: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class OrganisationRow:
    """An organisation: nobody gets into a tenant without one, and nothing can be recorded of it."""

    tenant_id: str
    name: str
    created_at: float
    closed_at: float | None
    """Nobody gets in any more: it is being deleted, or an operator has closed it."""
    max_bytes: float | None
    """Null: as in the settings. 0: no limit."""
    max_jobs: int | None
    max_gpu_minutes: float | None
    retention: dict[str, float] | None
    """Seconds after which things are deleted, by kind; null: never."""
    retention_enforced: int
    """Whether the server applies the rules by itself."""


@dataclass(frozen=True, kw_only=True, slots=True)
class UserRow:
    """A user."""

    id: str
    name: str
    email: str | None
    issuer: str | None
    """Who vouches for the user and the name there; null until the first sign-in."""
    subject: str | None
    created_at: float
    last_seen_at: float | None
    disabled_at: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class MemberRow:
    """A user in an organisation."""

    tenant_id: str
    user_id: str
    role: str
    """viewer, editor, admin"""
    source: str
    """operator, or claim: follows what the provider says at every sign-in"""
    created_at: float


@dataclass(frozen=True, kw_only=True, slots=True)
class AuditRow:
    """Something that was done. Triggers refuse changes, and deletions without a permit (`audit_permits`)."""

    tenant_id: str
    id: str
    """Its number with leading zeros, so that ids sort by it."""
    number: Number
    at: float
    actor_kind: str
    """key, session, user, link, operator, nobody"""
    actor_id: str
    action: str
    """The operation of the REST interface, or the command."""
    target: str
    address: str
    request_id: str
    outcome: str
    """done, or the code of the problem"""
    details: str
    """JSON, as it was hashed."""
    hash: str
    """Of the entry before and of everything in this one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class AuditHeadRow:
    """The newest entry of a tenant, and the newest of those that retention has removed."""

    tenant_id: str
    number: Number
    hash: str
    removed_number: Number
    removed_hash: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ServerRow:
    """A server that lives, or did not long ago."""

    id: str
    """Of the data folder, the same after every start."""
    host: str
    """Where its run processes can be seen: boot and pid namespace."""
    hostname: str
    """Its name, for people."""
    url: str
    endpoints: list[str]
    """Where runs reach it: ["unix:/data/worker.sock", "tls:10.0.0.7:8421"]."""
    version: str
    protocol: int
    slots: int
    gpus: int
    started_at: float
    """Times of the database's clock."""
    beat_at: float
    expires_at: float
