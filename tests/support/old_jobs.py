"""A database with years of history, written by a few statements: a million jobs take some minutes.

Nine tenths of the old jobs and a tenth of the queued ones belong to the tenant of `support.api`, the others
to a few and to a hundred tenants. A scene has ten jobs, a job four events and a label, and most trainings
have a bundle of two files.
"""

import re
from pathlib import Path

from lambent_server.database.engine import Database
from lambent_server.jobs import counts as job_counts
from sqlalchemy import Connection, text

YEARS_S = 2 * 365 * 86400.0
# The words of each database for what is in brackets.
_SQLITE = {
    "series": "(WITH RECURSIVE each(n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM each WHERE n + 1 < {0}) "
    "SELECT n FROM each) AS series",
    "id": "'{0}_0' || printf('%025d', {1})",
    "json": "{0}",
    "hex": "lower(hex(randomblob(32)))",
}
_POSTGRESQL = {
    "series": "generate_series(0, {0} - 1) AS series(n)",
    "id": "'{0}_0' || lpad(({1})::text, 25, '0')",
    "json": "({0})::json",
    "hex": "md5(random()::text) || md5(random()::text)",
}
_BYTES = (
    "INSERT INTO usage_sums (tenant_id, name, amount) "
    "SELECT tenant_id, 'bytes', sum(size_bytes) FROM blobs GROUP BY tenant_id "
    "ON CONFLICT (tenant_id, name) DO UPDATE SET amount = excluded.amount"
)
"""What the trigger on blobs would have summed up."""
_BRACKETS = (
    ("series", r"\[series ([^]]+)\]"),
    ("id", r"\[id (\w+) ([^]]+)\]"),
    ("json", r"\[json ([^]]+)\]"),
    ("hex", r"\[hex\]"),
)


def identifier(kind: str, number: int) -> str:
    """Return the id of the old job of a number ("job"), of its bundle, or of the scene of a number."""
    return f"{kind}_0{number:025d}"


def fill(database: Database, num_old: int, num_queued: int, *, end: float) -> None:
    """Add jobs that ended in the two years before `end`, and queued ones that need a GPU each."""
    script = re.sub(r"^--.*$", "", Path(__file__).with_suffix(".sql").read_text(), flags=re.MULTILINE)
    words = _SQLITE if database.is_sqlite else _POSTGRESQL
    for name, pattern in _BRACKETS:
        script = re.sub(pattern, lambda given, name=name: words[name].format(*given.groups()), script)
    values = {"num_old": num_old, "num_queued": num_queued, "end": end, "years": YEARS_S}
    for name, value in values.items():
        script = script.replace(f":{name}", repr(value))
    with database.write() as connection:
        indexes = _indexes(connection)
        # Much faster than adding every row to them.
        for name in indexes:
            connection.execute(text(f"DROP INDEX {name}"))
        if not database.is_sqlite:
            # It updates one row of a tenant for each blob, and PostgreSQL reads all versions of a row that a
            # transaction has made: the time would grow with the square of the number of blobs.
            connection.execute(text("ALTER TABLE blobs DISABLE TRIGGER blobs_bytes_added"))
        for statement in filter(str.strip, script.split(";")):
            connection.exec_driver_sql(statement if database.is_sqlite else statement.replace("%", "%%"))
        if not database.is_sqlite:
            connection.execute(text(_BYTES))
            connection.execute(text("ALTER TABLE blobs ENABLE TRIGGER blobs_bytes_added"))
        for statement in indexes.values():
            connection.execute(text(statement))
    job_counts.fold(database)
    analyze(database)


def analyze(database: Database) -> None:
    """Do at once what servers and PostgreSQL do within the hour."""
    database.analyze()
    if not database.is_sqlite:
        with database.write() as connection:
            connection.execute(text("ANALYZE"))


def _indexes(connection: Connection) -> dict[str, str]:
    """Return the indexes that are not keys, with the statements that make them."""
    statement = (
        "SELECT name, sql FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL"
        if connection.dialect.name == "sqlite"
        else "SELECT indexname, indexdef FROM pg_indexes WHERE schemaname = 'public' AND indexname LIKE 'ix%'"
    )
    return dict(iter(connection.execute(text(statement))))
