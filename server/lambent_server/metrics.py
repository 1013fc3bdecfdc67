"""Metrics for Prometheus."""

import shutil
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import func

from lambent_server import job_counts
from lambent_server.clock import now
from lambent_server.content_checks import BLOBS_DAMAGED, CHECKED_BYTES
from lambent_server.database.schema import jobs
from lambent_server.database.tenancy import across_tenants
from lambent_server.job_rows import FINAL, QUEUED, UNFINISHED, in_state
from lambent_server.service_metrics import ATTEMPTS, Told
from lambent_server.services import Services

REQUEST_SECONDS = Histogram(
    "lambent_request_seconds",
    "Time from the header of a request to the end of its response.",
    ["method", "route", "status"],
    buckets=(0.005, 0.02, 0.1, 0.5, 2.0, 10.0, 60.0),
    registry=None,
)
OPEN_STREAMS = Gauge("lambent_open_streams", "Open event streams.", registry=None)
OPEN_FILES = Gauge("lambent_open_files", "Open files of the server, connections included.", registry=None)
CONNECTIONS_CLOSED = Counter(
    "lambent_connections_closed_total", "Connections without a request, closed as too many.", registry=None
)
REQUESTS_REFUSED = Counter(
    "lambent_requests_refused_total", "Requests beyond a limit of connections.", ["code"], registry=None
)
RUNS_LOST = Counter("lambent_runs_lost_total", "Runs whose process vanished.", registry=None)
RUNS_STARTED = Counter("lambent_runs_started_total", "Runs that were started.", registry=None)
RUNS_FAILED = Counter("lambent_runs_failed_total", "Runs that failed, by cause.", ["cause"], registry=None)
UPLOAD_BYTES = Counter("lambent_upload_bytes_total", "Bytes of files uploaded over REST.", registry=None)
DIRECT_BYTES = Counter(
    "lambent_direct_upload_bytes_total", "Bytes of files uploaded directly to the store.", registry=None
)
WORKER_CALLS_REFUSED = Counter(
    "lambent_worker_calls_refused_total",
    "Calls of runs beyond their share, by reason.",
    ["reason"],
    registry=None,
)
_METRICS: tuple[Collector, ...] = (
    WORKER_CALLS_REFUSED,
    REQUEST_SECONDS,
    OPEN_STREAMS,
    OPEN_FILES,
    CONNECTIONS_CLOSED,
    REQUESTS_REFUSED,
    RUNS_LOST,
    RUNS_STARTED,
    RUNS_FAILED,
    UPLOAD_BYTES,
    DIRECT_BYTES,
    BLOBS_DAMAGED,
    CHECKED_BYTES,
)


class _State(Collector):
    """A collector that reads the database and the disk at the time of the request."""

    def __init__(self, services: Services) -> None:
        self._services = services

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics."""
        with self._services.database.read() as connection:
            counts = job_counts.of_all_tenants(connection)
            queued = across_tenants(jobs, func.min(jobs.c.created_at)).where(in_state(QUEUED))
            first = connection.execute(queued).scalar_one()
        family = GaugeMetricFamily("lambent_jobs", "Jobs by state.", labels=["state"])
        for state in sorted({*UNFINISHED, *FINAL, *counts}):
            family.add_metric([state], counts.get(state, 0))
        yield family
        oldest = 0.0 if first is None else now() - first
        yield GaugeMetricFamily("lambent_oldest_queued_seconds", "Age of the oldest queued job.", oldest)
        free = shutil.disk_usage(self._services.settings.data).free
        yield GaugeMetricFamily("lambent_disk_free_bytes", "Free space of the data folder.", free)


def registry(services: Services) -> CollectorRegistry:
    """Return the metrics of one server."""
    result = CollectorRegistry()
    for metric in (*_METRICS, ATTEMPTS):
        result.register(metric)
    result.register(_State(services))
    result.register(Told(services.database))
    return result
