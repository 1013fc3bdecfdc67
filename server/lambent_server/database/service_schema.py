"""Tables of what the server tells others, and of what its operators have told it."""

from sqlalchemy import Column, Double, Index, Integer, PrimaryKeyConstraint, Table, Text

from lambent_server.database.columns import metadata
from lambent_server.database.model import DeliveryRow, SecretRow, WebhookRow
from lambent_server.database.rows import table

webhooks = table("webhooks", WebhookRow, Index(None, "tenant_id", "id"))

webhook_secrets = table("webhook_secrets", SecretRow, PrimaryKeyConstraint("tenant_id"))

webhook_deliveries = table(
    "webhook_deliveries",
    DeliveryRow,
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
    Column("owner_id", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("value", Text, nullable=False),
    PrimaryKeyConstraint("owner_id", "name"),
    Index(None, "tenant_id", "name", "value"),
)

# What an operator has told all servers on this database: "drain", "maintenance".
server_state = Table(
    "server_state",
    metadata,
    Column("name", Text, primary_key=True),
    Column("since", Double, nullable=False),
    Column("message", Text, nullable=False),
    Column("retry_after_s", Integer, nullable=False, default=0),
)

# Which tenants a run was started for last: the larger the number, the later.
tenant_turns = Table(
    "tenant_turns",
    metadata,
    Column("tenant_id", Text, primary_key=True),
    Column("turn", Integer, nullable=False, default=0),
)

# Files that may be sent to the bucket now: they count as stored until they are, or until this ends.
upload_reservations = Table(
    "upload_reservations",
    metadata,
    Column("tenant_id", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    # 0 once the file is stored: only its addresses are still valid
    Column("size_bytes", Double, nullable=False),
    Column("expires_at", Double, nullable=False),
    PrimaryKeyConstraint("tenant_id", "sha256"),
    Index(None, "expires_at"),
)
