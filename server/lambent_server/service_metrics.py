"""Metrics that are read from the database and the disk at the time of the request."""

import shutil
from collections.abc import Iterator

from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import func

from lambent_server import job_counts
from lambent_server.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.schema import jobs
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.database.tenancy import across_tenants
from lambent_server.job_rows import FINAL, QUEUED, UNFINISHED, in_state
from lambent_server.membership import members
from lambent_server.metrics import COUNTED
from lambent_server.server_state import DRAIN, MAINTENANCE, read
from lambent_server.services import Services


class _Jobs(Collector):
    """Jobs by state, and the disk."""

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


class _Service(Collector):
    """Webhooks that wait, servers, and notices of operators."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics."""
        waiting = across_tenants(webhook_deliveries, func.count(), func.min(webhook_deliveries.c.created_at))
        with self._database.read() as connection:
            notices = read(connection)
            servers = members(connection)
            count, first = connection.execute(waiting.where(webhook_deliveries.c.next_at.is_not(None))).one()
        alive = sum(each.is_alive for each in servers)
        yield GaugeMetricFamily("lambent_servers", "Servers on the database that live.", alive)
        leaders = sum(each.leads for each in servers)
        yield GaugeMetricFamily("lambent_leaders", "Those that lead: one, but for some seconds.", leaders)
        yield GaugeMetricFamily("lambent_webhooks_waiting", "Deliveries that are not yet done.", count)
        age = 0.0 if first is None else now() - first
        yield GaugeMetricFamily("lambent_oldest_webhook_seconds", "Age of the oldest of them.", age)
        for name in (DRAIN, MAINTENANCE):
            yield GaugeMetricFamily(f"lambent_{name}", f"Whether {name} is on.", float(name in notices))


def registry(services: Services) -> CollectorRegistry:
    """Return the metrics of one server."""
    result = CollectorRegistry()
    for metric in COUNTED:
        result.register(metric)
    result.register(_Jobs(services))
    result.register(_Service(services.database))
    return result
