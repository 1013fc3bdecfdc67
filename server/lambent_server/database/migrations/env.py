"""Run by alembic with the connection that `Database.migrate` holds."""

from alembic import context
from lambent_server.database.schema import metadata

context.configure(connection=context.config.attributes["connection"], target_metadata=metadata)
with context.begin_transaction():
    context.run_migrations()
