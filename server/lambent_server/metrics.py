"""Metrics for Prometheus."""

import shutil
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import func

from lambent_server.clock import now
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import across_tenants
from lambent_server.services import Services

REQUEST_SECONDS = Histogram(
    "lambent_request_seconds",
    "Time from the header of a request to the end of its response.",
    ["method", "route", "status"],
    buckets=(0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0),
    registry=None,
)
OPEN_STREAMS = Gauge("lambent_open_streams", "Open event streams.", registry=None)
RUNS_LOST = Counter("lambent_runs_lost_total", "Runs whose process vanished.", registry=None)
RUNS_STARTED = Counter("lambent_runs_started_total", "Runs that were started.", registry=None)
RUNS_FAILED = Counter("lambent_runs_failed_total", "Runs that failed, by cause.", ["cause"], registry=None)
UPLOAD_BYTES = Counter("lambent_upload_bytes_total", "Bytes of files uploaded over REST.", registry=None)


class _State(Collector):
    """A collector that reads the database and the disk at the time of the request."""

    def __init__(self, services: Services) -> None:
        self._services = services

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics."""
        with self._services.database.read() as connection:
            found = connection.execute(
                across_tenants(jobs, jobs.c.state, func.count(), func.min(jobs.c.created_at)).group_by(
                    jobs.c.state
                )
            ).all()
        family = GaugeMetricFamily("lambent_jobs", "Jobs by state.", labels=["state"])
        oldest = 0.0
        for state, count, first in found:
            family.add_metric([state], count)
            if state == "queued":
                oldest = now() - first
        yield family
        yield GaugeMetricFamily("lambent_oldest_queued_seconds", "Age of the oldest queued job.", oldest)
        free = shutil.disk_usage(self._services.settings.data).free
        yield GaugeMetricFamily("lambent_disk_free_bytes", "Free space of the data folder.", free)


def registry(services: Services) -> CollectorRegistry:
    """Return the metrics of one server."""
    result = CollectorRegistry()
    for metric in (REQUEST_SECONDS, OPEN_STREAMS, RUNS_LOST, RUNS_STARTED, RUNS_FAILED, UPLOAD_BYTES):
        result.register(metric)
    result.register(_State(services))
    return result
