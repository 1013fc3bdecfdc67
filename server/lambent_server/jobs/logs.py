"""Output of run processes: a file on the machine of the run, and a copy that all servers can read.

While a run writes, the server that started it copies new output to the database in pieces, so that it can be
read through any server, also when that one is gone; when the run has ended, the pieces are replaced by one
file in the store. The pieces of a run belong to the server that looks after it, which changes where another
one can take runs over. With SQLite there is one server, and the file is all there is.
"""

import threading
from pathlib import Path
from typing import Any

import structlog
from lambent_core.files import file_sha256
from sqlalchemy import Connection, delete, func, insert, select, update
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.api.problems import Problem
from lambent_server.cluster.membership import Membership
from lambent_server.core.clock import now
from lambent_server.database.cluster_schema import run_log_pieces, run_logs, servers
from lambent_server.database.model import JobRow
from lambent_server.database.rows import many
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, across_tenants, add_if_absent, remove, rows
from lambent_server.jobs.rows import is_observed
from lambent_server.services import Services
from lambent_server.storage.store import discard

log = structlog.get_logger()

PIECE_BYTES = 256 * 1024
KEPT_BYTES = 4 * 1024 * 1024
"""Of the output of one run, so much is copied: the end of it."""
_AT_START_S = 3600.0
"""A server that starts puts away the output of runs that have ended so lately. The leader puts away what is
older, and whose server is not known any more."""
_OVERLAP_S = 60.0
"""So much may the clocks of two servers differ."""
_AT_ONCE = 16
"""Pieces of one run in one round."""


def file_of(services: Services, job_id: str, run: int) -> Path:
    """Return where a run of this server writes its output."""
    return services.settings.runs / job_id / f"run-{run}.log"


def tail(services: Services, tenant: Tenant, job_id: str, run: int, num_bytes: int) -> bytes | None:
    """Return the end of a run's output, from wherever it is; None if there is none."""
    path = file_of(services, job_id, run)
    here = path.stat().st_size if path.exists() else -1
    with services.database.read() as connection:
        # Another server may have taken the run over, and this file ends where it did.
        if here >= _copied_bytes(connection, tenant, job_id, run):
            with path.open("rb") as file:
                file.seek(max(here - num_bytes, 0))
                return file.read(num_bytes)
        mine = rows(tenant, run_logs).where(run_logs.c.job_id == job_id, run_logs.c.run == run)
        ended = connection.execute(mine).one_or_none()
        if ended is None:
            pieces = _pieces_of(tenant, job_id, run).order_by(run_log_pieces.c.start)
            pieces_found = [row.data for row in connection.execute(pieces)]
            return b"".join(pieces_found)[-num_bytes:] if pieces_found else None
    size = int(ended.size_bytes)
    try:
        return b"".join(services.store.read(ended.sha256, size, max(size - num_bytes, 0), size))
    except Problem as problem:
        log.warning("log_lost", job=job_id, run=run, code=problem.code)
        return None


def _copied_bytes(connection: Connection, tenant: Tenant, job_id: str, run: int) -> int:
    """Return how far the copy of a run's output reaches; 0 if there is none."""
    named = rows(tenant, run_logs, run_logs.c.size_bytes).where(
        run_logs.c.job_id == job_id, run_logs.c.run == run
    )
    end = _end_of_pieces(run_log_pieces.c.tenant_id == tenant.id, *_of_run(job_id, run))
    ends = (connection.execute(statement).scalar_one_or_none() for statement in (named, end))
    return max(int(size or 0) for size in ends)


def _end_of_pieces(*conditions: Any) -> Any:
    return select(func.max(run_log_pieces.c.start + func.length(run_log_pieces.c.data))).where(*conditions)


def _of_run(job_id: str, run: int) -> tuple[Any, Any]:
    return run_log_pieces.c.job_id == job_id, run_log_pieces.c.run == run


def forget(connection: Connection, tenant: Tenant, job_id: str) -> None:
    """Remove the copies of a job's output."""
    named = rows(tenant, run_logs, run_logs.c.sha256).where(run_logs.c.job_id == job_id)
    for sha256 in set(connection.execute(named).scalars()):
        discard(connection, tenant, sha256)
    for table in (run_logs, run_log_pieces):
        connection.execute(remove(tenant, table).where(table.c.job_id == job_id))


def _pieces_of(tenant: Tenant, job_id: str, run: int) -> Any:
    return rows(tenant, run_log_pieces).where(*_of_run(job_id, run))


class LogCopier:
    """Copies the output of this server's runs to where other servers can read it, in its own thread."""

    def __init__(self, services: Services, membership: Membership) -> None:
        self._services = services
        self._membership = membership
        self._looked_at = now() - _AT_START_S
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="log-copier", daemon=True)

    def start(self) -> None:
        """Start the thread, unless nobody else can be there to read."""
        if not self._membership.is_alone:
            self._thread.start()

    def close(self) -> None:
        """Stop after the round that has begun, and a last one for the runs that this server has ended."""
        self._stopping.set()
        if not self._thread.is_alive():
            return
        self._thread.join(timeout=5)
        if not self._thread.is_alive():
            self._try_to_turn()

    def _loop(self) -> None:
        while not self._stopping.wait(self._services.settings.log_copy_s):
            self._try_to_turn()

    def _try_to_turn(self) -> None:
        try:
            self.turn()
        except (SQLAlchemyError, OSError) as error:
            # The database or the store is unavailable; the files are still there in the next round.
            log.warning("logs_not_copied", error=type(error).__name__)

    def turn(self) -> None:
        """Copy what is new of every unfinished run, and put away the output of those that have ended."""
        began = now()
        with self._services.database.read() as connection:
            going_on = {
                (job.id, job.run): job
                for job in many(connection, across_tenants(jobs).where(is_observed()), JobRow)
            }
            ended = self._with_pieces(connection, run_log_pieces.c.server_id == self._membership.id)
            ended |= self._ended_lately(connection)
            if self._membership.leads:
                ended |= self._left(connection)
        for job in going_on.values():
            if (job.handle or {}).get("server") == self._membership.id:
                self._copy(Tenant(job.tenant_id), job.id, job.run)
        for job_id, run, tenant_id in ended:
            if (job_id, run) not in going_on:
                self._put_away(Tenant(tenant_id), job_id, run)
        self._looked_at = began

    def _with_pieces(self, connection: Connection, condition: Any) -> set[tuple[Any, ...]]:
        """Return job, run and tenant of the runs with such pieces."""
        columns = (run_log_pieces.c.job_id, run_log_pieces.c.run, run_log_pieces.c.tenant_id)
        runs = across_tenants(run_log_pieces, *columns).where(condition).distinct()
        return {tuple(row) for row in connection.execute(runs)}

    def _left(self, connection: Connection) -> set[tuple[Any, ...]]:
        """Return job, run and tenant of runs with pieces of servers that will hardly come back for them."""
        unknown = run_log_pieces.c.server_id.not_in(select(servers.c.id))
        old = across_tenants(jobs, jobs.c.id).where(jobs.c.updated_at < now() - _AT_START_S)
        return self._with_pieces(connection, unknown & run_log_pieces.c.job_id.in_(old))

    def _ended_lately(self, connection: Connection) -> set[tuple[Any, ...]]:
        """Return job, run and tenant of runs of this server that ended since the last round, uncopied."""
        since = self._looked_at - _OVERLAP_S
        changed = across_tenants(jobs, jobs.c.id, jobs.c.run, jobs.c.tenant_id).where(
            jobs.c.updated_at > since
        )
        runs = {
            (job_id, run, tenant_id)
            for job_id, last, tenant_id in connection.execute(changed)
            for run in range(1, last + 1)
            if file_of(self._services, job_id, run).exists()
        }
        named = across_tenants(run_logs, run_logs.c.job_id, run_logs.c.run, run_logs.c.tenant_id)
        ids = {job_id for job_id, *_ in runs}
        some = named.where(run_logs.c.job_id.in_(ids))
        taken = across_tenants(run_log_pieces, run_log_pieces.c.server_id).where(
            run_log_pieces.c.job_id.in_(ids)
        )
        others = [
            server
            for server in connection.execute(taken.distinct()).scalars()
            if server != self._membership.id and self._membership.is_alive(server)
        ]
        theirs = run_log_pieces.c.job_id.in_(ids) & run_log_pieces.c.server_id.in_(others)
        copied = {tuple(row) for row in connection.execute(some)}
        return runs - copied - self._with_pieces(connection, theirs)

    def _copy(self, tenant: Tenant, job_id: str, run: int) -> None:
        path = file_of(self._services, job_id, run)
        if not path.exists():
            return
        size = path.stat().st_size
        own = _of_run(job_id, run)
        with self._services.database.write() as connection:
            # The pieces of a run that was taken over are those of its new server.
            taken = update(run_log_pieces).where(*own, run_log_pieces.c.server_id != self._membership.id)
            connection.execute(taken.values(server_id=self._membership.id))
            known = connection.execute(_end_of_pieces(*own)).scalar_one()
            start = max(int(known or 0), size - KEPT_BYTES)
            with path.open("rb") as file:
                file.seek(start)
                for _ in range(_AT_ONCE):
                    if not (data := file.read(PIECE_BYTES)):
                        break
                    connection.execute(
                        insert(run_log_pieces).values(
                            job_id=job_id,
                            run=run,
                            start=float(start),
                            tenant_id=tenant.id,
                            server_id=self._membership.id,
                            data=data,
                        )
                    )
                    start += len(data)
            old = run_log_pieces.c.start < float(start - KEPT_BYTES - PIECE_BYTES)
            connection.execute(remove(tenant, run_log_pieces).where(*own, old))

    def _put_away(self, tenant: Tenant, job_id: str, run: int) -> None:
        """Replace the pieces of a run that has ended by one file in the store."""
        database = self._services.database
        mine = _of_run(job_id, run)
        self._copy(tenant, job_id, run)
        with database.read() as connection:
            pieces = _pieces_of(tenant, job_id, run).order_by(run_log_pieces.c.start)
            data = b"".join(row.data for row in connection.execute(pieces))
        path = self._services.settings.scratch / f"{job_id}-{run}.log"
        try:
            path.write_bytes(data[-KEPT_BYTES:])
            sha256, size = file_sha256(path), path.stat().st_size
            self._services.store.put_file(database.write, tenant, path, sha256, "text/plain")
        finally:
            path.unlink(missing_ok=True)
        with database.write() as connection:
            exists = select(jobs.c.id).where(jobs.c.id == job_id).with_for_update()
            if connection.execute(exists).first() is None:
                # Deleted meanwhile.
                connection.execute(delete(run_log_pieces).where(*mine))
                discard(connection, tenant, sha256)
                return
            named = {"job_id": job_id, "run": run, "sha256": sha256, "size_bytes": float(size)}
            add_if_absent(connection, tenant, run_logs, **named)
            connection.execute(remove(tenant, run_log_pieces).where(*mine))
