"""Tables of who may do what, how much, and what was done.

An organisation is a tenant: its id is the `tenant_id` of every row that belongs to it.
"""

from sqlalchemy import (
    BigInteger,
    Column,
    Double,
    ForeignKeyConstraint,
    Index,
    Integer,
    PrimaryKeyConstraint,
    Table,
    Text,
    UniqueConstraint,
)

from lambent_server.database.columns import metadata
from lambent_server.database.model import AuditHeadRow, AuditRow, MemberRow, OrganisationRow, UserRow
from lambent_server.database.rows import table

_BIG = BigInteger().with_variant(Integer, "sqlite")

organisations = table("organisations", OrganisationRow, PrimaryKeyConstraint("tenant_id"))

users = table("users", UserRow, UniqueConstraint("issuer", "subject"), UniqueConstraint("email"))

members = table(
    "members",
    MemberRow,
    ForeignKeyConstraint(["user_id"], ["users.id"], ondelete="CASCADE"),
    PrimaryKeyConstraint("tenant_id", "user_id"),
    Index(None, "user_id"),
)

# Sign-ins that have begun at the provider; each is used once.
sign_ins = Table(
    "sign_ins",
    metadata,
    Column("state_sha256", Text, primary_key=True),
    Column("nonce", Text, nullable=False),
    Column("verifier", Text, nullable=False),
    Column("return_to", Text, nullable=False),
    Column("created_at", Double, nullable=False),
    Index(None, "created_at"),
)

# Running sums of a tenant: "bytes" that it stores (triggers on `blobs` keep it), "gpu_s 2026-11" of a month.
usage_sums = Table(
    "usage_sums",
    metadata,
    Column("tenant_id", Text, nullable=False),
    Column("name", Text, nullable=False),
    Column("amount", Double, nullable=False),
    PrimaryKeyConstraint("tenant_id", "name"),
)

audit_entries = table(
    "audit_entries", AuditRow, PrimaryKeyConstraint("tenant_id", "id"), Index(None, "tenant_id", "target")
)

audit_heads = table("audit_heads", AuditHeadRow, PrimaryKeyConstraint("tenant_id"))

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
    Column("tenant_id", Text, nullable=False),
    Column("envelope", Text, nullable=False),
    Column("created_at", Double, nullable=False),
)
