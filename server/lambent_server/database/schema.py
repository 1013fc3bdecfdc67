"""Tables. Times are Unix seconds; every row of a tenant carries `tenant_id`."""

from sqlalchemy import (
    JSON,
    Column,
    Double,
    Index,
    Integer,
    MetaData,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
)

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _text(name: str) -> Column[str]:
    return Column(name, Text, nullable=False)


def _time(name: str) -> Column[float]:
    return Column(name, Double, nullable=False)


def _count(name: str) -> Column[int]:
    return Column(name, Integer, nullable=False, default=0)


def _id() -> Column[str]:
    return Column("id", Text, primary_key=True)


def _optional_text(name: str) -> Column[str | None]:
    return Column(name, Text)


def _optional_time(name: str) -> Column[float | None]:
    return Column(name, Double)


api_keys = Table(
    "api_keys",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("name"),
    _text("key_sha256"),
    _time("created_at"),
    _optional_time("expires_at"),
    _optional_time("revoked_at"),
    _optional_time("last_used_at"),
    UniqueConstraint("key_sha256"),
)

sessions = Table(
    "sessions",
    metadata,
    Column("token_sha256", Text, primary_key=True),
    _text("tenant_id"),
    _time("created_at"),
    _time("expires_at"),
)

scenes = Table(
    "scenes",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("name"),
    # open (being uploaded), uploaded, ready (checked and usable), rejected
    _text("state"),
    _optional_text("layout"),
    _time("created_at"),
    _optional_time("committed_at"),
    _optional_text("content_sha256"),
    _count("num_files"),
    Column("size_bytes", Double, nullable=False, default=0),
    # SceneReport as REST shows it
    Column("report", JSON),
    # One of its photographs, small
    _optional_text("thumbnail_sha256"),
    Index(None, "thumbnail_sha256"),
)

scene_files = Table(
    "scene_files",
    metadata,
    _text("scene_id"),
    _text("path"),
    _text("tenant_id"),
    _text("sha256"),
    Column("size_bytes", Double, nullable=False),
    PrimaryKeyConstraint("scene_id", "path"),
    Index(None, "sha256"),
)

scene_figures = Table(
    "scene_figures",
    metadata,
    Column("scene_id", Text, primary_key=True),
    _text("tenant_id"),
    # CaptureFigures as REST shows them
    Column("figures", JSON, nullable=False),
    # The page that shows them; "" if there is none
    _text("sha256"),
    Index(None, "sha256"),
)

jobs = Table(
    "jobs",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("kind"),
    _text("scene_id"),
    _text("preset"),
    Column("params", JSON, nullable=False),
    _count("gpus"),
    _count("priority"),
    Column("labels", JSON, nullable=False),
    _count("seed"),
    _text("state"),
    # The fence: counts the starts.
    _count("run"),
    _time("created_at"),
    _time("updated_at"),
    _optional_time("started_at"),
    _optional_time("finished_at"),
    Column("progress", JSON(none_as_null=True)),
    Column("error", JSON(none_as_null=True)),
    _optional_text("bundle_id"),
    _count("failures"),
    _count("losses"),
    _count("losses_without_checkpoint"),
    # {"ray_chunk": 0.5, "learning_rate": 0.5}: what the next run does differently
    Column("adjustments", JSON, nullable=False),
    _optional_time("retry_at"),
    # Why the controller is ending the run: "cancel" or "stall".
    _optional_text("stop_reason"),
    _optional_time("stop_at"),
    # The executor's handle of the process; null if there is none.
    Column("handle", JSON(none_as_null=True)),
    _optional_time("run_started_at"),
    _optional_time("heartbeat_at"),
    _optional_time("progress_at"),
    _optional_time("progress_event_at"),
    _count("event_seq"),
    _count("report_seq"),
    # The order of pictures and the part of it that the job renders; null for other kinds.
    _optional_text("order_id"),
    Column("shard", Integer),
    # The newest preview; its event holds the blob.
    _optional_text("preview_sha256"),
    Index(None, "tenant_id", "id"),
    # Of pages of jobs in one state among thousands of others.
    Index(None, "tenant_id", "state", "id"),
    Index(None, "state"),
    Index(None, "order_id"),
    Index(None, "scene_id"),
    # The most frequent query of event streams.
    Index(None, "updated_at"),
)

render_orders = Table(
    "render_orders",
    metadata,
    _id(),
    _text("tenant_id"),
    # "render" or "batch"
    _text("kind"),
    _text("name"),
    # RenderSpec as REST accepts it, with every name filled in
    Column("spec", JSON, nullable=False),
    _count("num_pictures"),
    _count("num_shards"),
    _time("created_at"),
    Index(None, "tenant_id", "id"),
)

job_labels = Table(
    "job_labels",
    metadata,
    _text("job_id"),
    _text("name"),
    _text("tenant_id"),
    _text("value"),
    PrimaryKeyConstraint("job_id", "name"),
    Index(None, "tenant_id", "name", "value"),
)

events = Table(
    "events",
    metadata,
    _text("job_id"),
    Column("seq", Integer, nullable=False),
    _text("tenant_id"),
    _time("at"),
    _text("type"),
    _count("run"),
    _text("state"),
    Column("progress", JSON(none_as_null=True)),
    _text("message"),
    _text("sha256"),
    _text("name"),
    PrimaryKeyConstraint("job_id", "seq"),
    Index(None, "sha256"),
)

checkpoints = Table(
    "checkpoints",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("job_id"),
    _count("run"),
    _text("stage"),
    _count("step"),
    _time("created_at"),
    Column("manifest", JSON, nullable=False),
    # The scene that it is kept with; null if it goes with the job.
    _optional_text("scene_id"),
    Index(None, "job_id"),
    Index(None, "scene_id"),
)

checkpoint_files = Table(
    "checkpoint_files",
    metadata,
    _text("checkpoint_id"),
    _text("path"),
    _text("tenant_id"),
    _text("sha256"),
    PrimaryKeyConstraint("checkpoint_id", "path"),
    Index(None, "sha256"),
)

artifacts = Table(
    "artifacts",
    metadata,
    _text("job_id"),
    _text("name"),
    _text("tenant_id"),
    _text("sha256"),
    Column("size_bytes", Double, nullable=False),
    _text("media_type"),
    PrimaryKeyConstraint("job_id", "name"),
    Index(None, "sha256"),
)

bundles = Table(
    "bundles",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("job_id"),
    _text("scene_id"),
    _time("created_at"),
    UniqueConstraint("job_id"),
)

bundle_files = Table(
    "bundle_files",
    metadata,
    _text("bundle_id"),
    _text("path"),
    _text("tenant_id"),
    _text("sha256"),
    Column("size_bytes", Double, nullable=False),
    _text("media_type"),
    PrimaryKeyConstraint("bundle_id", "path"),
    Index(None, "sha256"),
)

# Links that give everyone who has one read access to a bundle.
shares = Table(
    "shares",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("bundle_id"),
    _time("created_at"),
    _time("expires_at"),
    _optional_time("revoked_at"),
    # Origins whose pages may show the bundle, separated by spaces; none if it is null.
    _optional_text("frame_ancestors"),
    Index(None, "bundle_id"),
)

environments = Table(
    "environments",
    metadata,
    _id(),
    _text("tenant_id"),
    _text("name"),
    _text("format"),
    _count("width"),
    _count("height"),
    _text("sha256"),
    Column("size_bytes", Double, nullable=False),
    _time("created_at"),
    Index(None, "sha256"),
)

# A tenant can read a blob if it has a row here; the bytes themselves are shared.
blobs = Table(
    "blobs",
    metadata,
    _text("sha256"),
    _text("tenant_id"),
    Column("size_bytes", Double, nullable=False),
    _text("media_type"),
    # Updated by every upload of the same bytes, so that nothing just sent is swept.
    _time("touched_at"),
    PrimaryKeyConstraint("tenant_id", "sha256"),
    Index(None, "sha256"),
)

# Blobs that may have lost their last reference.
garbage = Table(
    "garbage",
    metadata,
    _text("sha256"),
    _text("tenant_id"),
    _time("at"),
    PrimaryKeyConstraint("tenant_id", "sha256"),
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    _text("key"),
    _text("tenant_id"),
    _text("body_sha256"),
    _text("job_id"),
    _time("created_at"),
    PrimaryKeyConstraint("tenant_id", "key"),
)
