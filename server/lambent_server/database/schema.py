"""Tables. Times are Unix seconds; every row of a tenant carries `tenant_id`."""

from sqlalchemy import (
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
from lambent_server.database.columns import metadata
from lambent_server.database.model import (
    ArtifactRow,
    BundleFileRow,
    BundleRow,
    CheckpointRow,
    EnvironmentRow,
    EventRow,
    FiguresRow,
    JobRow,
    KeyRow,
    OrderRow,
    SceneFileRow,
    SceneRow,
    ShareRow,
)
from lambent_server.database.rows import table


def _partial(name: str, *columns: str, where: str) -> Index:
    """Return an index of the rows that fulfil a condition: it does not grow with history.

    A database uses it only for queries that repeat the condition literally (`job_rows` has them).
    """
    return Index(name, *columns, sqlite_where=text(where), postgresql_where=text(where))


api_keys = table("api_keys", KeyRow, UniqueConstraint("key_sha256"))

sessions = Table(
    "sessions",
    metadata,
    Column("token_sha256", Text, primary_key=True),
    Column("tenant_id", Text, nullable=False),
    Column("created_at", Double, nullable=False),
    Column("expires_at", Double, nullable=False),
    # Null: a one-time link was opened
    Column("user_id", Text),
    Column("maker_user_id", Text),
    Column("maker_key_id", Text),
    # Hash of the token of the session in which that link was made; null: in none
    Column("maker_session", Text),
    Index(None, "expires_at"),
)

scenes = table(
    "scenes",
    SceneRow,
    Index(None, "thumbnail_sha256"),
    Index(None, "tenant_id", "id"),
    _partial("ix_scenes_open", "created_at", where="state = 'open'"),
)

scene_files = table(
    "scene_files", SceneFileRow, PrimaryKeyConstraint("scene_id", "path"), Index(None, "sha256")
)

scene_figures = table("scene_figures", FiguresRow, PrimaryKeyConstraint("scene_id"), Index(None, "sha256"))

jobs = table(
    "jobs",
    JobRow,
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
    Column("tenant_id", Text, nullable=False),
    Column("state", Text, nullable=False),
    Column("num_jobs", Integer, nullable=False, default=0),
    Index(None, "tenant_id", "state"),
)

render_orders = table(
    "render_orders", OrderRow, Index(None, "tenant_id", "id"), Index(None, "tenant_id", "kind", "id")
)

job_labels = Table(
    "job_labels",
    metadata,
    Column("job_id", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("value", Text, nullable=False),
    PrimaryKeyConstraint("job_id", "name"),
    Index(None, "tenant_id", "name", "value", "job_id"),
)

events = table("events", EventRow, PrimaryKeyConstraint("job_id", "seq"), Index(None, "sha256"))

checkpoints = table(
    "checkpoints", CheckpointRow, Index(None, "job_id"), Index(None, "scene_id"), Index(None, "number")
)

checkpoint_files = Table(
    "checkpoint_files",
    metadata,
    Column("checkpoint_id", Text, nullable=False),
    Column("path", Text, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    PrimaryKeyConstraint("checkpoint_id", "path"),
    Index(None, "sha256"),
)

artifacts = table("artifacts", ArtifactRow, PrimaryKeyConstraint("job_id", "name"), Index(None, "sha256"))

bundles = table("bundles", BundleRow, UniqueConstraint("job_id"), Index(None, "tenant_id", "id"))

bundle_files = table(
    "bundle_files",
    BundleFileRow,
    PrimaryKeyConstraint("bundle_id", "path"),
    Index(None, "sha256"),
    Index(None, "gzip_bytes"),
)

shares = table("shares", ShareRow, Index(None, "bundle_id"), Index(None, "expires_at"))

environments = table("environments", EnvironmentRow, Index(None, "sha256"), Index(None, "tenant_id", "id"))

# A tenant can read a blob if it has a row here; the bytes themselves are shared.
blobs = Table(
    "blobs",
    metadata,
    Column("sha256", Text, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("size_bytes", Double, nullable=False),
    Column("media_type", Text, nullable=False),
    # Updated by every upload of the same bytes, so that nothing just sent is swept.
    Column("touched_at", Double, nullable=False),
    PrimaryKeyConstraint("tenant_id", "sha256"),
    Index(None, "sha256"),
)

# Blobs that may have lost their last reference.
garbage = Table(
    "garbage",
    metadata,
    Column("sha256", Text, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("at", Double, nullable=False),
    PrimaryKeyConstraint("tenant_id", "sha256"),
    Index(None, "at"),
)

idempotency_keys = Table(
    "idempotency_keys",
    metadata,
    Column("key", Text, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("body_sha256", Text, nullable=False),
    Column("job_id", Text, nullable=False),
    Column("created_at", Double, nullable=False),
    PrimaryKeyConstraint("tenant_id", "key"),
    Index(None, "tenant_id", "job_id"),
    Index(None, "created_at"),
)
