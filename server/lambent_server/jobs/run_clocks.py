"""Clocks of silence and of stalls: the time without news of a run, in the running time of this server.

Clocks of machines differ, and a server that slept has seen nothing meanwhile: what counts is for how long
this server has looked at a value that did not change.
"""

from collections.abc import Iterable, Sequence
from typing import Any

from lambent_server.core.clock import LivedTime
from lambent_server.core.settings import Settings
from lambent_server.database.model import JobRow
from lambent_server.jobs.rows import CANCELLING

# A longer pause between two rounds means that the machine slept or the server was stopped.
_LONGEST_PAUSE_TICKS = 10
_HEARD = "heard"


class RunClocks:
    """What was seen of the jobs of each round, and since when."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self.lived = LivedTime(_LONGEST_PAUSE_TICKS * settings.tick_s)
        self._seen: dict[tuple[str, str], tuple[Any, float]] = {}

    def pass_on(self, observed: Sequence[JobRow], looked_after: Iterable[JobRow]) -> None:
        """Count the time since the last round, of all jobs with a run and those that this server judges."""
        self.lived.pass_on()
        known = {job.id for job in looked_after}
        there = {job.id for job in observed}
        self._seen = {
            (job_id, what): value
            for (job_id, what), value in self._seen.items()
            if job_id in (there if what == _HEARD else known)
        }
        for job in observed:
            self.unchanged_s(job, _HEARD, (job.run, job.heartbeat_at))

    def unchanged_s(self, job: JobRow, what: str, value: Any) -> float:
        """Return for how many seconds of this server's running time `value` has not changed."""
        key = (job.id, what)
        before, since = self._seen.get(key, (None, 0.0))
        if key not in self._seen or before != value:
            since = self.lived.seconds
            self._seen[key] = (value, since)
        return self.lived.seconds - since

    def is_silent(self, job: JobRow) -> bool:
        """Return whether a run that cannot be seen has said nothing for so long that it is gone.

        Silence counts from when this server began to judge the run, because it may need time to find another
        server. That of a cancelled run counts from its last heartbeat, and need not be as long: nothing
        starts in its place, and if it lives after all, its next call ends it.
        """
        heartbeat = (job.run, job.heartbeat_at)
        silent_s = self.unchanged_s(job, "heartbeat", heartbeat)
        limit_s = self._settings.lost_after_s
        if job.state == CANCELLING:
            silent_s = max(silent_s, self.unchanged_s(job, _HEARD, heartbeat))
            limit_s = min(limit_s, self._settings.stop_grace_s)
        return silent_s > limit_s

    def stall_s(self, job: JobRow) -> float:
        """Return for how many seconds the run has done no step, if that is too long; 0 if it is not."""
        still_s = self.unchanged_s(job, "progress", (job.run, job.progress_at))
        stage = (job.progress or {}).get("stage", "")
        return still_s if still_s > self._settings.stall_limit(stage) else 0.0
