"""Metrics that are read from the database and the disk at the time of the request."""

import shutil
from collections.abc import Iterator

from prometheus_client import CollectorRegistry
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import func

from lambent_server.cluster.membership import members
from lambent_server.cluster.server_state import DRAIN, MAINTENANCE, read
from lambent_server.core.clock import now
from lambent_server.core.metrics import OWN
from lambent_server.database.schema import jobs
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.database.tenancy import across_tenants
from lambent_server.jobs import counts as job_counts
from lambent_server.jobs.rows import FINAL, QUEUED, UNFINISHED, in_state
from lambent_server.services import Services


class _Stored(Collector):
    """Jobs by state, the disk, webhooks that wait, servers, and notices of operators."""

    def __init__(self, services: Services) -> None:
        self._services = services

    def collect(self) -> Iterator[GaugeMetricFamily]:
        """Yield the metrics."""
        waiting = across_tenants(webhook_deliveries, func.count(), func.min(webhook_deliveries.c.created_at))
        queued = across_tenants(jobs, func.min(jobs.c.created_at)).where(in_state(QUEUED))
        with self._services.database.read() as connection:
            counts = job_counts.of_all_tenants(connection)
            first_job = connection.execute(queued).scalar_one()
            notices = read(connection)
            servers = members(connection)
            unsent = waiting.where(webhook_deliveries.c.next_at.is_not(None))
            num_waiting, first_webhook = connection.execute(unsent).one()
        by_state = GaugeMetricFamily("lambent_jobs", "Jobs by state.", labels=["state"])
        for state in sorted({*UNFINISHED, *FINAL, *counts}):
            by_state.add_metric([state], counts.get(state, 0))
        yield by_state
        free = shutil.disk_usage(self._services.settings.data).free
        for name, text, value in (
            ("oldest_queued_seconds", "Age of the oldest queued job.", _age(first_job)),
            ("disk_free_bytes", "Free space of the data folder.", free),
            ("servers", "Servers on the database that live.", sum(each.is_alive for each in servers)),
            ("leaders", "Those that lead: one, but for some seconds.", sum(each.leads for each in servers)),
            ("webhooks_waiting", "Deliveries that are not yet done.", num_waiting),
            ("oldest_webhook_seconds", "Age of the oldest of them.", _age(first_webhook)),
            *((name, f"Whether {name} is on.", float(name in notices)) for name in (DRAIN, MAINTENANCE)),
        ):
            yield GaugeMetricFamily(f"lambent_{name}", text, value)


def _age(since: float | None) -> float:
    return 0.0 if since is None else now() - since


def registry(services: Services) -> CollectorRegistry:
    """Return the metrics of one server."""
    result = CollectorRegistry()
    result.register(OWN)
    result.register(_Stored(services))
    return result
