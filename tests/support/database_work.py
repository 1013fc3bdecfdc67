"""The work of a database, counted and not timed: instructions of SQLite, rows read by PostgreSQL."""

import contextlib
from collections import Counter
from collections.abc import Iterator
from typing import Any

from lambent_server.database.engine import Database
from sqlalchemy import event

STEPS_AT_ONCE = 50


class Work:
    """Counts the instructions that SQLite executes, or the rows that PostgreSQL reads."""

    def __init__(self, database: Database) -> None:
        self.by_statement: Counter[str] = Counter()
        self._statement = ""
        engine = database.engine
        event.listen(engine, "before_cursor_execute", self._begin if database.is_sqlite else self._count_rows)
        if database.is_sqlite:
            event.listen(engine, "connect", self._count_steps)
            # Connections that were opened before do not count.
            engine.dispose()

    @property
    def amount(self) -> int:
        """Return the number of instructions or rows."""
        return self.by_statement.total()

    @contextlib.contextmanager
    def counted(self) -> Iterator[None]:
        """Count from zero what happens inside of the block."""
        self.by_statement.clear()
        yield

    def _begin(self, _connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        self._statement = statement

    def _count_steps(self, raw: Any, _record: Any) -> None:
        raw.set_progress_handler(self._step, STEPS_AT_ONCE)

    def _step(self) -> int:
        self.by_statement[self._statement] += STEPS_AT_ONCE
        return 0

    def _count_rows(self, _connection: Any, cursor: Any, statement: str, values: Any, *_: Any) -> None:
        if statement.lstrip().split(" ", 1)[0] not in ("SELECT", "UPDATE", "DELETE", "WITH"):
            return
        with cursor.connection.cursor() as other:
            other.execute("SAVEPOINT counted")
            other.execute(f"EXPLAIN (ANALYZE, FORMAT JSON) {statement}", values)
            self.by_statement[statement] += _rows(other.fetchone()[0][0]["Plan"])
            other.execute("ROLLBACK TO counted")


def _rows(plan: dict[str, Any]) -> int:
    """Return how many rows the scans of a plan have read, those that a condition refused included."""
    names = ("Actual Rows", "Rows Removed by Filter", "Rows Removed by Index Recheck")
    read = sum(plan.get(name, 0) for name in names) if "Scan" in plan["Node Type"] else 0
    return int(read * plan["Actual Loops"]) + sum(_rows(each) for each in plan.get("Plans", ()))
