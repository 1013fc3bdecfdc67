"""Scenes by part of their name, without looking at every name where the database can do so."""

from typing import Any

from sqlalchemy import Connection, Select, column, func, inspect, table

from lambent_server.database.schema import scenes
from lambent_server.database.tenancy import Tenant, rows

SHORTEST = 3
"""Letters from which the index of names helps."""
# Tables of SQLite alone, which `database.creation` makes and triggers keep up to date.
_NAMES = table("scene_names", column("rowid"), column("scene_names"))
_NUMBERS = table("scene_numbers", column("number"), column("scene_id"))


def named(connection: Connection, tenant: Tenant, words: str) -> Select[Any]:
    """Return the query of the ids of the tenant's scenes whose name contains `words`, in any case.

    PostgreSQL uses its index of `lower(name)` by itself.
    """
    matching_ids = rows(tenant, scenes, scenes.c.id).where(scenes.c.name.icontains(words, autoescape=True))
    if connection.dialect.name == "sqlite" and len(words) >= SHORTEST and _has_index(connection):
        # As one phrase, whatever characters it has. Joined, and not IN, which would collect all first.
        phrase = '"' + words.replace('"', '""') + '"'
        joined = _NAMES.join(_NUMBERS, _NUMBERS.c.number == _NAMES.c.rowid).join(
            scenes, scenes.c.id == _NUMBERS.c.scene_id
        )
        matching = _NAMES.c.scene_names.op("MATCH")(func.lower(phrase))
        matching_ids = matching_ids.select_from(joined).where(matching)
    return matching_ids


def _has_index(connection: Connection) -> bool:
    """Return whether SQLite knew FTS5 when the tables were made."""
    return inspect(connection).has_table(_NAMES.name)
