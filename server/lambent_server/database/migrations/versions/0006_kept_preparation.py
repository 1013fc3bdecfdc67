"""Checkpoints that are kept with a scene, for every later job of it, and an index of a scene's jobs."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    op.add_column("checkpoints", sa.Column("scene_id", sa.Text(), nullable=True))
    op.create_index(op.f("ix_checkpoints_scene_id"), "checkpoints", ["scene_id"], unique=False)
    op.create_index(op.f("ix_jobs_scene_id"), "jobs", ["scene_id"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_jobs_scene_id"), table_name="jobs")
    op.drop_index(op.f("ix_checkpoints_scene_id"), table_name="checkpoints")
    op.drop_column("checkpoints", "scene_id")
