"""Tables of the bytes behind blobs, which tenants share; `schema` has the rows of each tenant."""

from sqlalchemy import Column, Double, Index, Table, Text

from lambent_server.database.schema import metadata

# Whoever writes or deletes the bytes of a hash locks its row, in whichever process.
blob_claims = Table(
    "blob_claims",
    metadata,
    Column("sha256", Text, primary_key=True),
    # "kept" or "deleting".
    Column("state", Text, nullable=False),
    # Changes when a deletion begins, so that a writer notices one that came in between.
    Column("token", Text, nullable=False),
    Column("claimed_at", Double, nullable=False),
    # When the scrubber compared the bytes with the hash; 0: never.
    Column("checked_at", Double, nullable=False, server_default="0"),
    Index(None, "state"),
    Index(None, "checked_at"),
)
