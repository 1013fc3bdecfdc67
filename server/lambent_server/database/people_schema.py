"""Tables of who may do what, how much, and what was done.

An organisation is a tenant: its id is the `tenant_id` of every row that belongs to it.
"""

from sqlalchemy import (
    JSON,
    BigInteger,
    Column,
    Double,
    ForeignKey,
    Index,
    Integer,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
)

from lambent_server.database.columns import (
    count_column,
    id_column,
    metadata,
    optional_text_column,
    optional_time_column,
    text_column,
    time_column,
)

_BIG = BigInteger().with_variant(Integer, "sqlite")

# Nobody gets into a tenant without a row here, and nothing can be recorded of it.
organisations = Table(
    "organisations",
    metadata,
    Column("tenant_id", Text, primary_key=True),
    text_column("name"),
    time_column("created_at"),
    # Nobody gets in any more: it is being deleted, or an operator has closed it.
    optional_time_column("closed_at"),
    # Null: as in the settings. 0: no limit.
    Column("max_bytes", Double),
    Column("max_jobs", Integer),
    Column("max_gpu_minutes", Double),
    # Seconds after which things are deleted, by kind; null: never
    Column("retention", JSON(none_as_null=True)),
    # Whether the server applies the rules by itself
    count_column("retention_enforced"),
)

users = Table(
    "users",
    metadata,
    id_column(),
    text_column("name"),
    optional_text_column("email"),
    # Who vouches for the user and the name there; null until the first sign-in.
    optional_text_column("issuer"),
    optional_text_column("subject"),
    time_column("created_at"),
    optional_time_column("last_seen_at"),
    optional_time_column("disabled_at"),
    UniqueConstraint("issuer", "subject"),
    UniqueConstraint("email"),
)

members = Table(
    "members",
    metadata,
    text_column("tenant_id"),
    Column("user_id", Text, ForeignKey("users.id", ondelete="CASCADE"), nullable=False),
    # viewer, editor, admin
    text_column("role"),
    # "operator", or "claim": follows what the provider says at every sign-in
    text_column("source"),
    time_column("created_at"),
    PrimaryKeyConstraint("tenant_id", "user_id"),
    Index(None, "user_id"),
)

# Sign-ins that have begun at the provider; each is used once.
sign_ins = Table(
    "sign_ins",
    metadata,
    Column("state_sha256", Text, primary_key=True),
    text_column("nonce"),
    text_column("verifier"),
    text_column("return_to"),
    time_column("created_at"),
    Index(None, "created_at"),
)

# Running sums of a tenant: "bytes" that it stores (triggers on `blobs` keep it), "gpu_s 2026-11" of a month.
usage_sums = Table(
    "usage_sums",
    metadata,
    text_column("tenant_id"),
    text_column("name"),
    Column("amount", Double, nullable=False),
    PrimaryKeyConstraint("tenant_id", "name"),
)

# What was done. Triggers refuse changes, and deletions unless `audit_permits` has a row for them.
audit_entries = Table(
    "audit_entries",
    metadata,
    text_column("tenant_id"),
    # Its number with leading zeros, so that ids sort by it
    text_column("id"),
    Column("number", _BIG, nullable=False),
    time_column("at"),
    # key, session, user, link, operator
    text_column("actor_kind"),
    text_column("actor_id"),
    # The operation of the REST interface, or the command
    text_column("action"),
    text_column("target"),
    text_column("address"),
    text_column("request_id"),
    # "done", or the code of the problem
    text_column("outcome"),
    # JSON, as it was hashed
    text_column("details"),
    # Of the entry before and of everything in this one
    text_column("hash"),
    PrimaryKeyConstraint("tenant_id", "id"),
    Index(None, "tenant_id", "target"),
)

# The newest entry of each tenant, and the newest of those that retention has removed.
audit_heads = Table(
    "audit_heads",
    metadata,
    Column("tenant_id", Text, primary_key=True),
    Column("number", _BIG, nullable=False),
    text_column("hash"),
    Column("removed_number", _BIG, nullable=False),
    text_column("removed_hash"),
)

# Up to which entry a transaction may delete those of a tenant; it takes the row back before it ends.
audit_permits = Table(
    "audit_permits",
    metadata,
    Column("tenant_id", Text, primary_key=True),
    Column("up_to", _BIG, nullable=False),
)

# The signed statement of where a bundle is from: a DSSE envelope as JSON.
provenance_statements = Table(
    "provenance_statements",
    metadata,
    Column("bundle_id", Text, primary_key=True),
    text_column("tenant_id"),
    text_column("envelope"),
    time_column("created_at"),
)
