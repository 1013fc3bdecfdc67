"""Orders of pictures, and the part of an order that a job renders."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    op.create_table(
        "render_orders",
        sa.Column("id", sa.Text(), nullable=False),
        sa.Column("tenant_id", sa.Text(), nullable=False),
        sa.Column("kind", sa.Text(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("spec", sa.JSON(), nullable=False),
        sa.Column("num_pictures", sa.Integer(), nullable=False),
        sa.Column("num_shards", sa.Integer(), nullable=False),
        sa.Column("created_at", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_render_orders")),
    )
    op.create_index(op.f("ix_render_orders_tenant_id_id"), "render_orders", ["tenant_id", "id"], unique=False)
    op.add_column("jobs", sa.Column("order_id", sa.Text(), nullable=True))
    op.add_column("jobs", sa.Column("shard", sa.Integer(), nullable=True))
    op.create_index(op.f("ix_jobs_order_id"), "jobs", ["order_id"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_jobs_order_id"), table_name="jobs")
    op.drop_column("jobs", "shard")
    op.drop_column("jobs", "order_id")
    op.drop_index(op.f("ix_render_orders_tenant_id_id"), table_name="render_orders")
    op.drop_table("render_orders")
