"""Claims on the bytes of blobs, which several processes may write and delete."""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"


def upgrade() -> None:
    op.create_table(
        "blob_claims",
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.Column("state", sa.Text(), nullable=False),
        sa.Column("token", sa.Text(), nullable=False),
        sa.Column("claimed_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("sha256", name=op.f("pk_blob_claims")),
    )
    op.create_index(op.f("ix_blob_claims_state"), "blob_claims", ["state"], unique=False)


def downgrade() -> None:
    op.drop_table("blob_claims")
