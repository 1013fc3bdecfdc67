"""Tables by which several servers on one database know each other and share what they need."""

from sqlalchemy import Column, Double, Index, Integer, LargeBinary, PrimaryKeyConstraint, Table, Text

from lambent_server.database.columns import metadata
from lambent_server.database.model import ServerRow
from lambent_server.database.rows import table

servers = table("servers", ServerRow)

# One row: who leads, and until when unless it says so again. PostgreSQL only.
leadership = Table(
    "leadership",
    metadata,
    Column("name", Text, primary_key=True),
    Column("holder", Text, nullable=False),
    # Counts the leaders
    Column("term", Integer, nullable=False, default=0),
    Column("expires_at", Double, nullable=False),
)

# What only servers know.
shared_secrets = Table(
    "shared_secrets",
    metadata,
    Column("name", Text, primary_key=True),
    Column("value", Text, nullable=False),
    Column("created_at", Double, nullable=False),
)

# Codes of one-time links for browsers.
login_codes = Table(
    "login_codes",
    metadata,
    Column("code_sha256", Text, primary_key=True),
    Column("tenant_id", Text, nullable=False),
    Column("created_at", Double, nullable=False),
    Column("expires_at", Double, nullable=False),
    Column("maker_user_id", Text),
    Column("maker_key_id", Text),
    # Hash of the token of the session in which it was made; null: in none
    Column("maker_session", Text),
    Index(None, "expires_at"),
)

# Output of runs, as far as another server than the one that has the file must know it. PostgreSQL only.
run_log_pieces = Table(
    "run_log_pieces",
    metadata,
    Column("job_id", Text, nullable=False),
    Column("run", Integer, nullable=False),
    # Offset in the file
    Column("start", Double, nullable=False),
    Column("tenant_id", Text, nullable=False),
    # Which server has the file
    Column("server_id", Text, nullable=False),
    Column("data", LargeBinary, nullable=False),
    PrimaryKeyConstraint("job_id", "run", "start"),
    Index(None, "server_id"),
)

# The same of runs that have ended, in the store.
run_logs = Table(
    "run_logs",
    metadata,
    Column("job_id", Text, nullable=False),
    Column("run", Integer, nullable=False),
    Column("tenant_id", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    Column("size_bytes", Double, nullable=False),
    PrimaryKeyConstraint("job_id", "run"),
    Index(None, "sha256"),
)

# "compatible_from": the oldest revision whose servers can still work with these tables.
schema_info = Table(
    "schema_info",
    metadata,
    Column("name", Text, primary_key=True),
    Column("value", Text, nullable=False),
)

# Whoever writes or deletes the bytes of a hash, which tenants share, locks its row in whichever process.
blob_claims = Table(
    "blob_claims",
    metadata,
    Column("sha256", Text, primary_key=True),
    # "kept" or "deleting".
    Column("state", Text, nullable=False),
    # Changes when a deletion begins, so that a writer notices one that came in between.
    Column("token", Text, nullable=False),
    Column("claimed_at", Double, nullable=False),
    # When the scrubber compared the bytes with the hash; 0: never.
    Column("checked_at", Double, nullable=False, server_default="0"),
    Index(None, "state"),
    Index(None, "checked_at"),
)
