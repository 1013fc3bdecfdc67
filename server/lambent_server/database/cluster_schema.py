"""Tables by which several servers on one database know each other and share what they need."""

from sqlalchemy import JSON, Column, Double, Index, Integer, LargeBinary, PrimaryKeyConstraint, Table, Text

from lambent_server.database.columns import (
    count_column,
    maker_columns,
    metadata,
    optional_text_column,
    text_column,
    time_column,
)

# Servers that live, and for a while those that do not any more.
servers = Table(
    "servers",
    metadata,
    # Of the data folder, the same after every start
    Column("id", Text, primary_key=True),
    # Where its run processes can be seen: boot and pid namespace
    text_column("host"),
    # Its name, for people
    text_column("hostname"),
    text_column("url"),
    # Where runs reach it: ["unix:/data/worker.sock", "tls:10.0.0.7:8421"]
    Column("endpoints", JSON, nullable=False),
    text_column("version"),
    count_column("protocol"),
    count_column("slots"),
    count_column("gpus"),
    # Times of the database's clock
    time_column("started_at"),
    time_column("beat_at"),
    time_column("expires_at"),
)

# One row: who leads, and until when unless it says so again. PostgreSQL only.
leadership = Table(
    "leadership",
    metadata,
    Column("name", Text, primary_key=True),
    text_column("holder"),
    # Counts the leaders
    count_column("term"),
    time_column("expires_at"),
)

# What only servers know.
shared_secrets = Table(
    "shared_secrets",
    metadata,
    Column("name", Text, primary_key=True),
    text_column("value"),
    time_column("created_at"),
)

# Codes of one-time links for browsers.
login_codes = Table(
    "login_codes",
    metadata,
    Column("code_sha256", Text, primary_key=True),
    text_column("tenant_id"),
    time_column("created_at"),
    time_column("expires_at"),
    *maker_columns(),
    # Hash of the token of the session in which it was made; null: in none
    optional_text_column("maker_session"),
    Index(None, "expires_at"),
)

# Output of runs, as far as another server than the one that has the file must know it. PostgreSQL only.
run_log_pieces = Table(
    "run_log_pieces",
    metadata,
    text_column("job_id"),
    Column("run", Integer, nullable=False),
    # Offset in the file
    Column("start", Double, nullable=False),
    text_column("tenant_id"),
    # Which server has the file
    text_column("server_id"),
    Column("data", LargeBinary, nullable=False),
    PrimaryKeyConstraint("job_id", "run", "start"),
    Index(None, "server_id"),
)

# The same of runs that have ended, in the store.
run_logs = Table(
    "run_logs",
    metadata,
    text_column("job_id"),
    Column("run", Integer, nullable=False),
    text_column("tenant_id"),
    text_column("sha256"),
    Column("size_bytes", Double, nullable=False),
    PrimaryKeyConstraint("job_id", "run"),
    Index(None, "sha256"),
)

# "compatible_from": the oldest revision whose servers can still work with these tables.
schema_info = Table(
    "schema_info",
    metadata,
    Column("name", Text, primary_key=True),
    text_column("value"),
)
