"""Tables. Times are Unix seconds; every row of a tenant carries `tenant_id`."""

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    Double,
    Index,
    Integer,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
    text,
)

# Their tables belong to the same registry.
from lambent_server.database import cluster_schema, people_schema, service_schema  # noqa: F401
from lambent_server.database.columns import (
    count_column,
    id_column,
    maker_columns,
    metadata,
    optional_text_column,
    optional_time_column,
    text_column,
    time_column,
)

_count, _id, _text, _time = count_column, id_column, text_column, time_column
_optional_text, _optional_time = optional_text_column, optional_time_column


def _partial(name: str, *columns: str, where: str) -> Index:
    """Return an index of the rows that fulfil a condition: it does not grow with history.

    A database uses it only for queries that repeat the condition literally (`job_rows` has them).
    """
    return Index(name, *columns, sqlite_where=text(where), postgresql_where=text(where))


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
    # Separated by spaces; null: all of them
    _optional_text("scopes"),
    # Whose key it is; null: nobody's in particular
    _optional_text("user_id"),
    *maker_columns(),
    UniqueConstraint("key_sha256"),
)

sessions = Table(
    "sessions",
    metadata,
    Column("token_sha256", Text, primary_key=True),
    _text("tenant_id"),
    _time("created_at"),
    _time("expires_at"),
    # Null: a one-time link was opened
    _optional_text("user_id"),
    *maker_columns(),
    # Hash of the token of the session in which that link was made; null: in none
    _optional_text("maker_session"),
    Index(None, "expires_at"),
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
    Column("labels", JSON(none_as_null=True)),
    Index(None, "thumbnail_sha256"),
    Index(None, "tenant_id", "id"),
    _partial("ix_scenes_open", "created_at", where="state = 'open'"),
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
    # The newest preview but for the sheet of an evaluation; its event holds the blob.
    _optional_text("preview_sha256"),
    # Where its end is told.
    _optional_text("webhook"),
    *maker_columns(),
    # What counts against the GPU minutes of its tenant until it has ended, at least.
    _optional_time("gpu_s_reserved"),
    Index(None, "tenant_id", "id"),
    # Of pages of few jobs among many others (`job_pages`).
    Index(None, "tenant_id", "state", "id"),
    Index(None, "tenant_id", "kind", "id"),
    Index(None, "tenant_id", "kind", "state", "id"),
    Index(None, "scene_id", "id"),
    Index(None, "tenant_id", "preset", "id"),
    Index(None, "order_id"),
    # The most frequent query of event streams.
    Index(None, "updated_at"),
    # What the controller looks at in every round.
    _partial("ix_jobs_observed", "id", where="state IN ('running', 'cancelling') OR handle IS NOT NULL"),
    # Groups of jobs that may start, each with its oldest job first (`queue_order`).
    _partial(
        "ix_jobs_queue",
        "gpus",
        "priority",
        "tenant_id",
        "id",
        where="state = 'queued' AND handle IS NULL",
    ),
    _partial("ix_jobs_due", "retry_at", where="state = 'retry_wait'"),
    _partial("ix_jobs_queued_since", "created_at", where="state = 'queued'"),
)

# How many jobs of a tenant are in a state: the sum of `num_jobs`. Triggers on `jobs` add a row for every
# change, so that no transaction waits for another; `job_counts.fold` replaces the rows by their sums. A
# migration that recreates `jobs` has to recreate its triggers (`creation`).
job_counts = Table(
    "job_counts",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True),
    _text("tenant_id"),
    _text("state"),
    _count("num_jobs"),
    Index(None, "tenant_id", "state"),
)

render_orders = Table(
    "render_orders",
    metadata,
    _id(),
    _text("tenant_id"),
    # "render" or "batch"
    _text("kind"),
    _text("name"),
    # RenderSpec as REST accepts it, with the names of its environments filled in
    Column("spec", JSON, nullable=False),
    _count("num_pictures"),
    _count("num_shards"),
    _time("created_at"),
    Index(None, "tenant_id", "id"),
    Index(None, "tenant_id", "kind", "id"),
)

job_labels = Table(
    "job_labels",
    metadata,
    _text("job_id"),
    _text("name"),
    _text("tenant_id"),
    _text("value"),
    PrimaryKeyConstraint("job_id", "name"),
    Index(None, "tenant_id", "name", "value", "job_id"),
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
    # The order in which they were committed, whatever clocks say
    Column("number", BigInteger, nullable=False),
    Column("manifest", JSON, nullable=False),
    # The scene that it is kept with; null if it goes with the job.
    _optional_text("scene_id"),
    Index(None, "job_id"),
    Index(None, "scene_id"),
    Index(None, "number"),
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
    Column("labels", JSON(none_as_null=True)),
    UniqueConstraint("job_id"),
    Index(None, "tenant_id", "id"),
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
    # Size of the compressed copy; 0 if it saves too little, -1 if the file is gone, null if not known yet.
    Column("gzip_bytes", Double),
    PrimaryKeyConstraint("bundle_id", "path"),
    Index(None, "sha256"),
    Index(None, "gzip_bytes"),
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
    *maker_columns(),
    Index(None, "bundle_id"),
    Index(None, "expires_at"),
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
    Index(None, "tenant_id", "id"),
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
    Index(None, "at"),
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
    Index(None, "tenant_id", "job_id"),
    Index(None, "created_at"),
)
