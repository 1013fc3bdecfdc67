"""Estimates of a job's duration, from the jobs that have finished on this server."""

import statistics
from itertools import islice

from sqlalchemy import Connection, func

from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import Tenant, rows
from lambent_server.job_parameters import CORRECTIONS
from lambent_server.job_rows import FINAL, SUCCEEDED
from lambent_server.messages import Estimate, Preset

NUM_JOBS = 20
"""Number of the newest jobs of a preset that count."""


def estimate(connection: Connection, tenant: Tenant, preset: Preset) -> Estimate:
    """Return the estimated duration of a job of this preset, without time in the queue.

    Based on jobs with the preset's own settings that succeeded in their first run; the preset's budget
    if there are none.
    """
    plain = rows(tenant, jobs, jobs.c.started_at, jobs.c.finished_at, jobs.c.params).where(
        jobs.c.preset == preset.name,
        jobs.c.kind == "train",
        jobs.c.state == SUCCEEDED,
        jobs.c.run == 1,
        jobs.c.gpus >= preset.gpus,
        jobs.c.started_at.is_not(None),
    )
    newest = connection.execute(plain.order_by(jobs.c.id.desc()))
    plain_times = (row.finished_at - row.started_at for row in newest if set(row.params) <= {CORRECTIONS})
    times = list(islice(plain_times, NUM_JOBS))
    ahead = rows(tenant, jobs, func.count()).where(jobs.c.state.not_in(FINAL))
    return Estimate(
        preset=preset.name,
        seconds=statistics.median(times) if times else preset.budget_s,
        shortest_s=min(times, default=None),
        longest_s=max(times, default=None),
        num_measured=len(times),
        num_ahead=connection.execute(ahead).scalar_one(),
    )
