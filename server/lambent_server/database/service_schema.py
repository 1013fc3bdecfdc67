"""Tables of what the server tells others, and of what its operators have told it."""

from sqlalchemy import JSON, Column, Double, Index, PrimaryKeyConstraint, Table, Text

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

# Standing subscriptions to changes of jobs.
webhooks = Table(
    "webhooks",
    metadata,
    id_column(),
    text_column("tenant_id"),
    text_column("name"),
    text_column("url"),
    # Types of events, such as "job.succeeded"
    Column("events", JSON, nullable=False),
    # Labels that a job must have
    Column("labels", JSON, nullable=False),
    text_column("secret"),
    # Signs too, until that time
    optional_text_column("previous_secret"),
    optional_time_column("previous_until"),
    time_column("created_at"),
    optional_time_column("disabled_at"),
    # "gone" if the receiver said so, "asked" if a person did, "maker_left" if whoever made it has left
    text_column("disabled_reason"),
    *maker_columns(),
    Index(None, "tenant_id", "id"),
)

# What signs the deliveries that jobs ask for themselves.
webhook_secrets = Table(
    "webhook_secrets",
    metadata,
    Column("tenant_id", Text, primary_key=True),
    text_column("secret"),
    optional_text_column("previous_secret"),
    optional_time_column("previous_until"),
)

# The outbox: written together with the change that it tells.
webhook_deliveries = Table(
    "webhook_deliveries",
    metadata,
    # The receiver's key against duplicates
    id_column(),
    text_column("tenant_id"),
    # Null if the job asked for it
    optional_text_column("webhook_id"),
    # Null for a ping
    optional_text_column("job_id"),
    text_column("event"),
    text_column("url"),
    # Host and port, for the limit of simultaneous deliveries
    text_column("host"),
    # The bytes to send, the same at every attempt
    text_column("body"),
    # pending, delivered, failed
    text_column("state"),
    time_column("created_at"),
    # When the attempts began: those of a repeat count anew
    time_column("since"),
    # When the next attempt is due; null if there is none
    optional_time_column("next_at"),
    # Who is making the attempt now; `next_at` is when others may assume that it was lost
    optional_text_column("claim"),
    count_column("num_attempts"),
    # The newest attempts: {"at", "status", "error", "seconds"}
    Column("attempts", JSON, nullable=False),
    optional_time_column("ended_at"),
    Index(None, "next_at"),
    Index(None, "tenant_id", "next_at"),
    Index(None, "tenant_id", "id"),
    Index(None, "webhook_id"),
    Index(None, "job_id"),
    Index(None, "ended_at"),
)

# Labels of scenes and bundles; those of jobs have a table of their own.
resource_labels = Table(
    "resource_labels",
    metadata,
    text_column("owner_id"),
    text_column("name"),
    text_column("tenant_id"),
    text_column("value"),
    PrimaryKeyConstraint("owner_id", "name"),
    Index(None, "tenant_id", "name", "value"),
)

# What an operator has told all servers on this database: "drain", "maintenance".
server_state = Table(
    "server_state",
    metadata,
    Column("name", Text, primary_key=True),
    time_column("since"),
    text_column("message"),
    count_column("retry_after_s"),
)

# Which tenants a run was started for last: the larger the number, the later.
tenant_turns = Table(
    "tenant_turns",
    metadata,
    Column("tenant_id", Text, primary_key=True),
    count_column("turn"),
)

# Files that may be sent to the bucket now: they count as stored until they are, or until this ends.
upload_reservations = Table(
    "upload_reservations",
    metadata,
    text_column("tenant_id"),
    text_column("sha256"),
    # 0 once the file is stored: only its addresses are still valid
    Column("size_bytes", Double, nullable=False),
    time_column("expires_at"),
    PrimaryKeyConstraint("tenant_id", "sha256"),
    Index(None, "expires_at"),
)
