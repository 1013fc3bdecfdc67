"""Estimates of a job's duration, from the jobs that have finished on this server."""

import statistics
from collections.abc import Iterator
from itertools import islice

from sqlalchemy import Connection, select

from lambent_server.api.messages import Estimate, Preset
from lambent_server.api.parameters import CORRECTIONS
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.jobs.queries import num_unfinished
from lambent_server.jobs.rows import SUCCEEDED

NUM_JOBS = 20
"""Number of the newest jobs of a preset that count."""
NUM_READ = 100
"""Number of the newest successful jobs of a preset among which these are looked for."""
NUM_SEEN = 500
"""Number of the newest jobs of a preset among which the successful ones are looked for."""


def estimate(connection: Connection, tenant: Tenant, preset: Preset) -> Estimate:
    """Return the estimated duration of a job of this preset, without time in the queue.

    Based on jobs with the preset's own settings that succeeded in their first run; the preset's budget
    if there are none.
    """
    times = list(islice(_plain_times(connection, tenant, preset), NUM_JOBS))
    return Estimate(
        preset=preset.name,
        seconds=statistics.median(times) if times else preset.budget_s,
        shortest_s=min(times, default=None),
        longest_s=max(times, default=None),
        num_measured=len(times),
        num_ahead=num_unfinished(connection, tenant),
    )


def _plain_times(connection: Connection, tenant: Tenant, preset: Preset) -> Iterator[float]:
    """Yield the durations of jobs with the preset's own settings, newest first."""
    columns = ("id", "kind", "state", "run", "gpus", "params", "started_at", "finished_at")
    of_preset = rows(tenant, jobs, *(jobs.c[name] for name in columns)).where(jobs.c.preset == preset.name)
    newest = of_preset.order_by(jobs.c.id.desc()).limit(NUM_SEEN).subquery()
    measured = select(newest).where(
        newest.c.kind == "train",
        newest.c.state == SUCCEEDED,
        newest.c.run == 1,
        newest.c.gpus >= preset.gpus,
        newest.c.started_at.is_not(None),
    )
    for row in connection.execute(measured.order_by(newest.c.id.desc()).limit(NUM_READ)):
        if set(row.params) <= {CORRECTIONS}:
            yield row.finished_at - row.started_at
