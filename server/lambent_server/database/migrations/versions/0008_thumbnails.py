"""Pictures by which scenes and jobs are recognised, and an index for pages of jobs in one state.

Jobs get the newest preview of their history.
"""

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"

_NEWEST = """
UPDATE jobs SET preview_sha256 = (
    SELECT events.sha256 FROM events
    WHERE events.job_id = jobs.id AND events.type = 'preview' AND events.sha256 <> ''
    ORDER BY events.seq DESC LIMIT 1
)
"""


def upgrade() -> None:
    op.add_column("scenes", sa.Column("thumbnail_sha256", sa.Text(), nullable=True))
    op.create_index(op.f("ix_scenes_thumbnail_sha256"), "scenes", ["thumbnail_sha256"], unique=False)
    op.add_column("jobs", sa.Column("preview_sha256", sa.Text(), nullable=True))
    op.execute(_NEWEST)
    op.create_index(op.f("ix_jobs_tenant_id_state_id"), "jobs", ["tenant_id", "state", "id"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_jobs_tenant_id_state_id"), table_name="jobs")
    op.drop_column("jobs", "preview_sha256")
    op.drop_index(op.f("ix_scenes_thumbnail_sha256"), table_name="scenes")
    op.drop_column("scenes", "thumbnail_sha256")
