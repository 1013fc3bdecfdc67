"""Compressed copies of bundles' files; those of older bundles are made when the server has started."""

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"


def upgrade() -> None:
    op.add_column("bundle_files", sa.Column("gzip_bytes", sa.Double(), nullable=True))
    op.create_index(op.f("ix_bundle_files_gzip_bytes"), "bundle_files", ["gzip_bytes"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_bundle_files_gzip_bytes"), table_name="bundle_files")
    op.drop_column("bundle_files", "gzip_bytes")
