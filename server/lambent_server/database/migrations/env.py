"""Run by alembic with the connection that `Database.migrate` holds."""

from alembic import context
from lambent_server.database import schema  # noqa: F401 (all tables belong to the metadata)
from lambent_server.database.columns import metadata

# One by one: locks of the first are not held while the last builds its indexes.
context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    transaction_per_migration=True,
)
with context.begin_transaction():
    context.run_migrations()
