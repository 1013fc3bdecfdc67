"""The loop that brings processes in line with the job rows.

Each round compares rows with processes and acts on the difference. Between two rounds it keeps only how long
nothing has changed, so a server may end at any point: the next one waits as long again before it decides.
"""

import shutil
import threading
from collections import Counter
from typing import Any

import structlog
from sqlalchemy import Connection, not_, or_
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.clock import LivedTime, now
from lambent_server.database.leadership import Leadership
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import across_tenants
from lambent_server.executors import Executor, Gone, Launch
from lambent_server.housekeeping import sweep
from lambent_server.job_rows import (
    CANCELLING,
    FINAL,
    HAS_RUN,
    QUEUED,
    RETRY_WAIT,
    RUNNING,
    Job,
    move,
    set_fields,
)
from lambent_server.metrics import RUNS_STARTED
from lambent_server.outcomes import Failure, fail, lose, settle_cancel
from lambent_server.render_rows import waits_for_parts
from lambent_server.secrets import run_token
from lambent_server.services import Services

log = structlog.get_logger()

# A longer pause between two rounds means that the machine slept or the server was stopped.
_LONGEST_PAUSE_TICKS = 10


class Controller:
    """Starts queued jobs, monitors running ones and completes those that have ended."""

    def __init__(self, services: Services, executor: Executor, *, secret: str, address: str) -> None:
        self._services = services
        self._settings = services.settings
        self._executor = executor
        self._secret = secret
        self._address = address
        self.lived = LivedTime(_LONGEST_PAUSE_TICKS * self._settings.tick_s)
        self._seen: dict[tuple[str, str], tuple[Any, float]] = {}
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._paused = False
        self._leadership = Leadership(services.database)
        self._swept_at = 0.0
        self._thread = threading.Thread(target=self._loop, name="controller", daemon=True)
        self.turned_at = now()
        services.wakeups.listen(self._wake.set)

    def start(self) -> None:
        """Start the loop in its own thread."""
        self._thread.start()

    def close(self, *, stop_runs: bool) -> None:
        """Stop the loop and, with `stop_runs`, the run processes; otherwise the next server adopts them."""
        self._paused = True
        if stop_runs and self._leadership.held():
            self._stop_runs()
        self._stopping.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5)
        self._leadership.close()

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                if self._leadership.held():
                    self.turn()
                self.turned_at = now()
            except (SQLAlchemyError, OSError):
                # The database or the disk is unavailable; the rows say what to do once it is back.
                log.exception("controller_turn_failed")
                self._stopping.wait(self._settings.tick_s)
            self._wake.wait(self._settings.tick_s)
            self._wake.clear()

    def turn(self) -> None:
        """Process every job once."""
        changed = False
        observed = self._read(or_(jobs.c.state.in_(HAS_RUN), jobs.c.handle.is_not(None)))
        # Only now: while the database is unavailable, no run can report that it is alive.
        self.lived.pass_on()
        known = {job["id"] for job in observed}
        self._seen = {key: value for key, value in self._seen.items() if key[0] in known}
        for job in observed:
            changed |= self._observe(job)
        due = jobs.c.retry_at <= now()
        for job in self._read(jobs.c.state == RETRY_WAIT, due):
            with self._services.database.write() as connection:
                changed |= move(connection, job, QUEUED, "next try", retry_at=None)
        if not self._paused:
            changed |= self._start_queued()
        if now() - self._swept_at > self._settings.garbage_after_s / 2:
            self._swept_at = now()
            sweep(self._services)
        if changed:
            self._services.wakeups.signal()

    def _read(self, *conditions: Any) -> list[Job]:
        with self._services.database.read() as connection:
            statement = across_tenants(jobs).where(*conditions).order_by(jobs.c.id)
            return [dict(row) for row in connection.execute(statement).mappings()]

    def _unchanged_s(self, job: Job, what: str, value: Any) -> float:
        """Return for how many seconds of this server's running time `value` has not changed."""
        key = (job["id"], what)
        before, since = self._seen.get(key, (None, 0.0))
        if key not in self._seen or before != value:
            since = self.lived.seconds
            self._seen[key] = (value, since)
        return self.lived.seconds - since

    def _observe(self, job: Job) -> bool:
        handle = job["handle"] or {}
        placed = "pid" in handle
        gone = self._executor.poll(handle) if placed else None
        if gone is not None:
            return self._settle(job, gone)
        if not placed:
            # Started by a server that ended before it stored the handle; a live run registers itself.
            silent_s = self._unchanged_s(job, "heartbeat", (job["run"], job["heartbeat_at"]))
            return silent_s > self._settings.lost_after_s and self._settle(job, Gone(None))
        if job["state"] in FINAL or job["state"] in (QUEUED, RETRY_WAIT):
            return self._end(job, asked=True)
        if job["state"] == CANCELLING or job["stop_reason"] is not None:
            return self._end(job, asked=job["stop_at"] is not None)
        still_s = self._unchanged_s(job, "progress", (job["run"], job["progress_at"]))
        stage = (job["progress"] or {}).get("stage", "")
        if still_s > self._settings.stall_limit(stage):
            log.warning("run_stalled", job=job["id"], run=job["run"], stage=stage, still_s=still_s)
            with self._services.database.write() as connection:
                set_fields(connection, job, stop_reason="stall", stop_at=now())
            self._executor.stop(handle, force=False)
        return False

    def _end(self, job: Job, *, asked: bool) -> bool:
        """Ask a process that should not be running to exit, and kill it after the grace time."""
        waited_s = self._unchanged_s(job, "ending", job["run"])
        if not asked:
            with self._services.database.write() as connection:
                set_fields(connection, job, stop_at=now())
            self._executor.stop(job["handle"], force=False)
        elif waited_s > self._settings.stop_grace_s:
            log.warning("run_killed", job=job["id"], run=job["run"])
            self._executor.stop(job["handle"], force=True)
        return False

    def _settle(self, job: Job, gone: Gone) -> bool:
        """Update the job of a process that is gone."""
        with self._services.database.write() as connection:
            # The run's last report may have arrived after the row was read.
            statement = across_tenants(jobs).where(jobs.c.id == job["id"]).with_for_update()
            job = dict(connection.execute(statement).mappings().one())
            changed = self._judge(connection, job, gone)
        if changed and job["handle"] is not None:
            self._tidy(job)
        return changed

    def _tidy(self, job: Job) -> None:
        """Remove a run's files; the log stays, and so does the copy of the scene while it may be needed."""
        folder = self._work_dir(job).parent
        shutil.rmtree(self._work_dir(job), ignore_errors=True)
        with self._services.database.read() as connection:
            statement = across_tenants(jobs, jobs.c.state).where(jobs.c.id == job["id"])
            state = connection.execute(statement).scalar_one()
        if state in FINAL:
            shutil.rmtree(folder / "scene", ignore_errors=True)

    def _judge(self, connection: Connection, job: Job, gone: Gone) -> bool:
        set_fields(connection, job, handle=None)
        if job["state"] == CANCELLING:
            return settle_cancel(connection, job)
        if job["state"] != RUNNING:
            return True
        if job["stop_reason"] == "stall":
            message = "no step was done for too long; see the log"
            return fail(connection, job, Failure("stalled", "run_stalled", message), self._settings)
        if gone.exit_code is not None and gone.exit_code > 0:
            message = f"the run process ended with code {gone.exit_code}; see the log"
            return fail(connection, job, Failure("internal", "run_crashed", message), self._settings)
        how = "the process is gone" if not gone.exit_code else f"signal {-gone.exit_code}"
        log.warning("run_lost", job=job["id"], run=job["run"], how=how)
        return lose(connection, job, how, self._settings)

    def _start_queued(self) -> bool:
        waiting = self._read(jobs.c.state == QUEUED, jobs.c.handle.is_(None), not_(waits_for_parts()))
        if not waiting:
            return False
        busy = self._read(jobs.c.handle.is_not(None) | jobs.c.state.in_(HAS_RUN))
        in_use = {gpu for job in busy for gpu in (job["handle"] or {}).get("gpus", ())}
        free = [gpu for gpu in range(self._services.local_gpus) if gpu not in in_use]
        load = Counter(job["tenant_id"] for job in busy)
        slots = self._settings.local_slots - len(busy)
        started = False
        # Highest priority first, then the tenant with the fewest running jobs, then the oldest job.
        while waiting and slots > 0:
            waiting.sort(key=lambda job: (-job["priority"], load[job["tenant_id"]], job["id"]))
            job = waiting.pop(0)
            if job["gpus"] > len(free):
                continue
            gpus, free = tuple(free[: job["gpus"]]), free[job["gpus"] :]
            if self._start(job, gpus):
                started = True
                slots -= 1
                load[job["tenant_id"]] += 1
        return started

    def _work_dir(self, job: Job) -> Any:
        return self._settings.runs / job["id"] / f"run-{job['run']}"

    def _start(self, job: Job, gpus: tuple[int, ...]) -> bool:
        run = job["run"] + 1
        with self._services.database.write() as connection:
            moved = move(
                connection,
                job,
                RUNNING,
                run=run,
                started_at=job["started_at"] or now(),
                run_started_at=now(),
                heartbeat_at=None,
                progress_at=None,
                progress_event_at=None,
                report_seq=0,
                stop_reason=None,
                stop_at=None,
                handle={"gpus": list(gpus)},
            )
        if not moved:
            return False
        job = {**job, "run": run, "state": RUNNING}
        launch = Launch(
            job_id=job["id"],
            run=run,
            address=self._address,
            token=run_token(self._secret, job["id"], run),
            work_dir=self._work_dir(job),
            gpus=gpus,
        )
        try:
            handle = self._executor.start(launch)
        except OSError as error:
            log.exception("run_not_started", job=job["id"], run=run)
            with self._services.database.write() as connection:
                failure = Failure("internal", "run_not_started", f"the run process did not start: {error}")
                fail(connection, job, failure, self._settings)
                set_fields(connection, job, handle=None)
            return True
        RUNS_STARTED.inc()
        log.info("run_started", job=job["id"], run=run, pid=handle["pid"], gpus=handle["gpus"])
        with self._services.database.write() as connection:
            set_fields(connection, job, handle=handle)
        return True

    def _stop_runs(self) -> None:
        """Stop every run process within the grace time; they first write a checkpoint if they can."""
        deadline = now() + self._settings.shutdown_grace_s
        alive = [job for job in self._read(jobs.c.handle.is_not(None)) if "pid" in job["handle"]]
        for job in alive:
            self._executor.stop(job["handle"], force=False)
        while alive and now() < deadline:
            self._stopping.wait(0.1)
            alive = [job for job in alive if self._executor.poll(job["handle"]) is None]
        for job in alive:
            self._executor.stop(job["handle"], force=True)
