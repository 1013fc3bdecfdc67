"""Metrics of webhooks, of the servers, and of what operators have told them."""

from collections.abc import Iterator

from prometheus_client import Counter
from prometheus_client.core import GaugeMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy import func

from lambent_server.clock import now
from lambent_server.database.engine import Database
from lambent_server.database.service_schema import webhook_deliveries
from lambent_server.database.tenancy import across_tenants
from lambent_server.membership import members
from lambent_server.server_state import DRAIN, MAINTENANCE, read

ATTEMPTS = Counter(
    "lambent_webhook_attempts_total", "Attempts to deliver webhooks, by outcome.", ["outcome"], registry=None
)


class Told(Collector):
    """A collector that reads the outbox and the notices at the time of the request."""

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
