"""Measurements of a scene, and the page that shows them."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"


def upgrade() -> None:
    op.create_table(
        "scene_figures",
        sa.Column("scene_id", sa.Text(), nullable=False),
        sa.Column("tenant_id", sa.Text(), nullable=False),
        sa.Column("figures", sa.JSON(), nullable=False),
        sa.Column("sha256", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("scene_id", name=op.f("pk_scene_figures")),
    )
    op.create_index(op.f("ix_scene_figures_sha256"), "scene_figures", ["sha256"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_scene_figures_sha256"), table_name="scene_figures")
    op.drop_table("scene_figures")
