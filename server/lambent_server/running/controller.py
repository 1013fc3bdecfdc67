"""The loop that brings processes in line with the job rows.

Each round compares rows with processes and acts on the difference. Between two rounds it keeps only how long
nothing has changed, so a server may end at any point: the next one waits as long again before it decides.
"""

import shutil
import threading
import time
from collections import Counter
from dataclasses import replace
from typing import Any

import structlog
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.cluster.certificates import ServerAddress
from lambent_server.cluster.membership import Membership, full_handle
from lambent_server.cluster.server_state import DRAIN, Notices
from lambent_server.core.clock import now
from lambent_server.core.metrics import RUNS_STARTED
from lambent_server.core.secrets import run_token
from lambent_server.database.model import JobRow
from lambent_server.database.rows import many, one
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import across_tenants
from lambent_server.executors import (
    Executor,
    ExecutorAwayError,
    Gone,
    Handle,
    Launch,
    Room,
    is_placed,
    run_name,
)
from lambent_server.jobs.outcomes import Failure, fail, is_due, judge, wait_for_room
from lambent_server.jobs.rows import (
    CANCELLING,
    ENDED,
    FINAL,
    QUEUED,
    RETRY_WAIT,
    RUNNING,
    in_state,
    is_observed,
    move,
    owner,
    set_fields,
)
from lambent_server.jobs.run_clocks import RunClocks
from lambent_server.maintenance.housekeeping import is_more_due, sweep
from lambent_server.running.queue_order import QueueOrder, had_turn
from lambent_server.services import Services
from lambent_server.storage.outages import report

log = structlog.get_logger()

STUCK_S = 30.0
_LONG_AGO = float("-inf")
_KILLED_S = 2.0
"""How long the end of processes is waited for that were killed."""


class Controller:
    """Starts queued jobs, monitors running ones and completes those that have ended.

    Each server has its own runs. The leader also looks after those of servers that do not live any more, by
    their heartbeats if it cannot see their processes, and does what concerns all jobs.
    """

    def __init__(
        self,
        services: Services,
        executor: Executor,
        membership: Membership,
        *,
        secret: str,
        server_address: ServerAddress,
    ) -> None:
        self._services = services
        self._settings = services.settings
        self._executor = executor
        self._members = membership
        self._secret = secret
        self._server_address = server_address
        self.clocks = RunClocks(self._settings)
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._paused = False
        self._notices = Notices(services.database)
        self._swept_at = _LONG_AGO
        self._thread = threading.Thread(target=self._loop, name="controller", daemon=True)
        self.turned_at = time.monotonic()
        # Another server leads while this one's loop does nothing.
        membership.is_fit = lambda: not self.is_stuck
        services.wakeups.listen(self._wake.set)

    @property
    def is_stuck(self) -> bool:
        """Whether no job was looked at for so long that another server should lead."""
        return time.monotonic() - self.turned_at > STUCK_S + 10 * self._settings.tick_s

    def start(self) -> None:
        """Start the loop in its own thread."""
        self._thread.start()

    def close(self, *, stop_runs: bool) -> None:
        """Stop the loop and, with `stop_runs`, the run processes; otherwise the next server adopts them."""
        self._paused = True
        if stop_runs and self._members.controls:
            try:
                self._stop_runs()
            except (SQLAlchemyError, OSError) as error:
                report("runs_not_stopped", error)
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5)
        if not self._thread.is_alive() and self._members.controls:
            # What has ended meanwhile would otherwise have to be missed by another server first.
            self._try_to_turn()

    def _loop(self) -> None:
        while not self._stopping.is_set():
            if not self._members.controls or self._try_to_turn():
                self.turned_at = time.monotonic()
            else:
                self._stopping.wait(self._settings.tick_s)
            self._wake.wait(self._settings.tick_s)
            self._wake.clear()

    def _try_to_turn(self) -> bool:
        try:
            self.turn()
        except (SQLAlchemyError, OSError) as error:
            # The database or the disk is unavailable; the rows say what to do once it is back.
            report("controller_turn_failed", error)
            return False
        return True

    def turn(self) -> None:
        """Process once every job that this server has to look after."""
        changed, leads = False, self._members.leads
        # Before the rows: a run has its row before it has processes.
        runs = self._executor.runs()
        observed = self._read(is_observed())
        mine = [job for job in observed if self._is_mine(job)]
        orphans = [job for job in observed if self._is_orphan(job)]
        # Only now: while the database is unavailable, no run can report that it is alive.
        self.clocks.pass_on(observed, (*mine, *orphans) if leads else mine)
        for job in mine:
            changed |= self._observe(job)
            self.turned_at = time.monotonic()
        for job in orphans:
            # The leader may have no part in the cluster of the run: every server that has takes runs over.
            if is_placed(job.handle) and self._executor.adopt(job.handle):
                self._take_over(job)
            elif leads:
                changed |= self._observe(job) if self._sees(job) else self._observe_from_afar(job)
            self.turned_at = time.monotonic()
        for run in runs - {run_name(job.id, job.run) for job in observed}:
            self._executor.forget(run)
        due = (
            self._read(in_state(RETRY_WAIT), is_due(self._settings, now()), order=jobs.c.retry_at)
            if leads
            else ()
        )
        for job in due:
            with self._services.database.write() as connection:
                changed |= move(connection, job, QUEUED, "next try", retry_at=None)
        if not self._paused and DRAIN not in self._notices.now():
            changed |= self._start_queued()
        swept_s = time.monotonic() - self._swept_at
        if leads and not self._paused and swept_s > self._settings.garbage_after_s / 2:
            sweep(self._services)
            self._swept_at = _LONG_AGO if is_more_due(self._services) else time.monotonic()
        if changed:
            self._services.wakeups.signal()

    def _is_mine(self, job: JobRow) -> bool:
        """Return whether this server has started the run, in this life or an earlier one."""
        if self._members.is_alone:
            return True
        return (job.handle or {}).get("server") == self._members.id

    def _is_orphan(self, job: JobRow) -> bool:
        """Return whether the server that has started the run is dead."""
        return not self._is_mine(job) and not self._members.is_alive((job.handle or {}).get("server", ""))

    def _sees(self, job: JobRow) -> bool:
        handle = job.handle or {}
        return is_placed(handle) and self._executor.sees(handle)

    def _read(self, *conditions: Any, order: Any = jobs.c.id) -> list[JobRow]:
        with self._services.database.read() as connection:
            statement = across_tenants(jobs).where(*conditions).order_by(order)
            return many(connection, statement, JobRow)

    def _observe(self, job: JobRow) -> bool:
        handle = job.handle or {}
        placed = is_placed(handle)
        try:
            has_reported = job.heartbeat_at is not None
            gone = self._executor.poll(handle, has_reported=has_reported) if placed else None
        except ExecutorAwayError:
            return self._observe_from_afar(job)
        if gone is not None:
            return self._settle(job, gone)
        if not placed:
            # Started by a server that ended before it stored the handle; a live run registers itself.
            return self.clocks.is_silent(job) and self._settle(job, Gone(None))
        if job.state in FINAL or job.state in (QUEUED, RETRY_WAIT):
            return self._end(job, handle, asked=True)
        if job.state == CANCELLING or job.stop_reason is not None:
            return self._end(job, handle, asked=job.stop_at is not None)
        if self.clocks.stall_s(job) and self._stop_stalled(job):
            self._executor.stop(handle, force=False)
        return False

    def _observe_from_afar(self, job: JobRow) -> bool:
        """Judge a run that cannot be seen by what it says itself: it is told to stop with its heartbeat.

        One that was cancelled and has said that it ends is taken at its word.
        """
        if self.clocks.is_silent(job) or (job.state == CANCELLING and job.stop_reason == ENDED):
            return self._settle(job, Gone(None))
        if job.state == RUNNING and job.stop_reason is None and self.clocks.stall_s(job):
            self._stop_stalled(job)
        return False

    def _take_over(self, job: JobRow) -> None:
        """Make a run of a dead server one of this server, which sees it as well."""
        handle = job.handle or {}
        with self._services.database.write() as connection:
            fresh = across_tenants(jobs).where(jobs.c.id == job.id).with_for_update()
            now_there = one(connection, fresh, JobRow)
            if now_there is not None and now_there.handle == job.handle:
                set_fields(connection, job, handle={**handle, "server": self._members.id})
                log.info("run_taken_over", job=job.id, run=job.run, server=handle.get("server"))

    def _stop_stalled(self, job: JobRow) -> bool:
        """Note that a run has to end because it does no steps."""
        stage = (job.progress or {}).get("stage", "")
        still_s = self.clocks.stall_s(job)
        log.warning("run_stalled", job=job.id, run=job.run, stage=stage, still_s=still_s)
        with self._services.database.write() as connection:
            set_fields(connection, job, stop_reason="stall", stop_at=now())
        return True

    def _end(self, job: JobRow, handle: Handle, *, asked: bool) -> bool:
        """Ask a process that should not be running to exit, and kill it after the grace time."""
        waited_s = self.clocks.unchanged_s(job, "ending", job.run)
        if not asked:
            with self._services.database.write() as connection:
                set_fields(connection, job, stop_at=now())
            self._executor.stop(handle, force=False)
        elif waited_s > self._settings.stop_grace_s:
            log.warning("run_killed", job=job.id, run=job.run)
            self._executor.stop(handle, force=True)
        return False

    def _settle(self, job: JobRow, gone: Gone) -> bool:
        """Update the job of a process that is gone."""
        with self._services.database.write() as connection:
            # The run's last report may have arrived after the row was read.
            statement = across_tenants(jobs).where(jobs.c.id == job.id).with_for_update()
            fresh = one(connection, statement, JobRow)
            if fresh is None or _which_run(fresh) != _which_run(job):
                # Another server was faster.
                return False
            changed = judge(connection, fresh, gone, self._settings)
        if changed and fresh.handle is not None:
            self._tidy(fresh)
        return changed

    def _tidy(self, job: JobRow) -> None:
        """Remove a run's files; the log stays, and so does the copy of the scene while it may be needed."""
        folder = self._work_dir(job).parent
        shutil.rmtree(self._work_dir(job), ignore_errors=True)
        with self._services.database.read() as connection:
            statement = across_tenants(jobs, jobs.c.state).where(jobs.c.id == job.id)
            state = connection.execute(statement).scalar_one()
        if state in FINAL:
            shutil.rmtree(folder / "scene", ignore_errors=True)

    def _start_queued(self) -> bool:
        """Start jobs while there is room for them; several servers take from the same queue."""
        busy = self._read(is_observed())
        own = [job.handle or {} for job in busy if self._is_mine(job)]
        others = [job.handle or {} for job in busy if not self._is_mine(job)]
        room = self._executor.room(own, others)
        free = room.most_gpus()
        if free is None:
            return False
        load = Counter(job.tenant_id for job in busy)
        with self._services.database.read() as connection:
            queue = QueueOrder(connection, load, free)
        started = False
        while free is not None:
            with self._services.database.read() as connection:
                job = queue.next(connection, free)
            if job is None:
                break
            if self._start(job, room):
                started = True
                load[job.tenant_id] += 1
            free = room.most_gpus()
        return started

    def _work_dir(self, job: JobRow) -> Any:
        return self._settings.runs / job.id / f"run-{job.run}"

    def _start(self, job: JobRow, room: Room) -> bool:
        run, gpus = job.run + 1, room.take(job.gpus)
        with self._services.database.write() as connection:
            moved = move(
                connection,
                job,
                RUNNING,
                run=run,
                started_at=job.started_at or now(),
                run_started_at=now(),
                heartbeat_at=None,
                progress_at=None,
                progress_event_at=None,
                report_seq=0,
                stop_reason=None,
                stop_at=None,
                handle=self._placed({"gpus": list(gpus)}),
            )
            if moved:
                had_turn(connection, owner(job))
        # Not moved if another server was faster.
        if not moved:
            return False
        job = replace(job, run=run, state=RUNNING)
        launch = Launch(
            job_id=job.id,
            run=run,
            address=self._server_address.address,
            token=run_token(self._secret, job.id, run),
            work_dir=self._work_dir(job),
            num_gpus=job.gpus,
            gpus=gpus,
            servers=tuple(self._members.endpoints(self._members.host)),
            authority=self._server_address.authority,
            authority_name=self._server_address.authority_name,
        )
        try:
            handle = self._placed(self._executor.start(launch))
        except ExecutorAwayError as error:
            with self._services.database.write() as connection:
                wait_for_room(connection, job, str(error), self._settings)
                set_fields(connection, job, handle=None)
            return True
        except OSError as error:
            log.exception("run_not_started", job=job.id, run=run)
            with self._services.database.write() as connection:
                failure = Failure("internal", "run_not_started", f"the run process did not start: {error}")
                fail(connection, job, failure, self._settings)
                set_fields(connection, job, handle=None)
            return True
        RUNS_STARTED.inc()
        log.info("run_started", job=job.id, run=run, handle=handle)
        with self._services.database.write() as connection:
            set_fields(connection, job, handle=handle)
        return True

    def _placed(self, handle: Handle) -> Handle:
        return full_handle(self._members, handle, self._settings.executor)

    def _stop_runs(self) -> None:
        """Stop this server's run processes within `stop_runs_s`; they write a checkpoint if they can.

        Not those on other machines, which another server looks after, or this one when it starts again.
        """
        if self._executor.runs_elsewhere:
            return
        held = self._read(jobs.c.handle.is_not(None))
        alive = [job.handle for job in held if is_placed(job.handle) and self._is_mine(job)]
        for force, wait_s in ((False, self._settings.stop_runs_s), (True, _KILLED_S)):
            for handle in alive:
                self._executor.stop(handle, force=force)
            until = time.monotonic() + wait_s
            while alive and time.monotonic() < until:
                self._stopping.wait(0.1)
                alive = [handle for handle in alive if self._is_alive(handle)]

    def _is_alive(self, handle: Handle) -> bool:
        try:
            return self._executor.poll(handle) is None
        except ExecutorAwayError:
            return True


def _which_run(job: JobRow) -> tuple[int, bool]:
    return job.run, is_placed(job.handle)
