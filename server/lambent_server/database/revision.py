"""The revision of the tables of a database, and whether this version can use them."""

import re
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

import structlog
from sqlalchemy import Connection, inspect, text

log = structlog.get_logger()

_RELEASED = re.compile(r"r\d{4}")
_CURRENT = "SELECT version_num FROM alembic_version"


class SchemaTooNewError(Exception):
    """The tables were changed by a newer version that does not serve this one any more."""


class UnreleasedSchemaError(Exception):
    """The tables were made by a revision from before the first release."""


def revision_of_tables(connection: Connection) -> str | None:
    """Return the revision of the tables, None if there are none."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    return connection.execute(text(_CURRENT)).scalar_one_or_none()


def revision_of_file(path: Path) -> str | None:
    """Return the revision of the tables in a file of SQLite, None if it has none or cannot be read.

    Changes nothing: SQLite itself would merge the write-ahead log into the file, and create or remove files
    beside it.
    """
    if not path.exists():
        return None
    revision = _read(f"file:{quote(str(path))}?mode=ro&immutable=1")
    ahead = path.with_name(f"{path.name}-wal")
    if revision is None and ahead.exists():
        # The first tables may be in the log alone.
        with TemporaryDirectory() as folder:
            for each in (path, ahead):
                shutil.copyfile(each, Path(folder) / each.name)
            revision = _read(f"file:{quote(str(Path(folder) / path.name))}")
    return revision


def _read(uri: str) -> str | None:
    try:
        with closing(sqlite3.connect(uri, uri=True)) as raw:
            row = raw.execute(_CURRENT).fetchone()
    except sqlite3.DatabaseError:
        # Opening it in earnest says what is wrong.
        return None
    return None if row is None else str(row[0])


def require_released(current: str, place: str, option: str) -> None:
    """Refuse tables that no release has made; they are in `place`, which `option` has chosen."""
    if not _RELEASED.fullmatch(current):
        raise UnreleasedSchemaError(
            f"{place} was made by a revision of Lambent from before the first release (its tables have "
            f"revision {current}), and no release can read it; nothing was changed. Move it away, or choose "
            f"another with {option}"
        )


def is_served_by_newer(connection: Connection, current: str, head: str) -> bool:
    """Return whether the tables are of a newer version that serves `head`, the version of this code.

    Raises SchemaTooNewError if they are newer and do not.
    """
    if current <= head:
        return False
    statement = text("SELECT value FROM schema_info WHERE name = 'compatible_from'")
    compatible_from = connection.execute(statement).scalar_one()
    if head < compatible_from:
        raise SchemaTooNewError(
            f"its tables have revision {current}, and this version of Lambent knows {head}; those before "
            f"{compatible_from} cannot use them"
        )
    log.warning("schema_newer", found=current, known=head, compatible_from=compatible_from)
    return True
