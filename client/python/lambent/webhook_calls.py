"""The calls of a client about webhooks; receivers use `lambent.webhooks`."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from lambent import arguments, pictures
from lambent.connection import Connection
from lambent.models import Delivery, Webhook


def _webhook(webhook_id: str) -> str:
    return f"/v1/webhooks/{arguments.identifier(webhook_id, 'webhook_id')}"


class WebhookCalls:
    """Subscriptions to changes of jobs, and what was delivered; `Client.webhooks`."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def create(
        self,
        url: str,
        *,
        name: str = "webhook",
        events: Sequence[str] = (),
        labels: Mapping[str, str] | None = None,
        idempotency_key: str = "",
    ) -> Webhook:
        """Subscribe and return the subscription with its `secret`.

        `events` are such as "job.failed"; without any, the ends of jobs. With `labels` only jobs that have
        all of them are reported.
        """
        body: dict[str, Any] = {"url": arguments.text(url, "url"), "name": arguments.text(name, "name")}
        if events:
            body["events"] = arguments.text_list(events, "events")
        if labels:
            body["labels"] = arguments.texts(labels, "labels")
        return Webhook.from_json(pictures.post(self._connection, "/v1/webhooks", body, idempotency_key))

    def list(self) -> Iterator[Webhook]:
        """Return the subscriptions, newest first, without their secrets."""
        return map(Webhook.from_json, self._connection.pages("/v1/webhooks"))

    def change(self, webhook_id: str, **values: Any) -> Webhook:
        """Change `url`, `name`, `events`, `labels` (merged, None removes one) or `enabled`."""
        return Webhook.from_json(self._connection.json("PATCH", _webhook(webhook_id), json=values))

    def delete(self, webhook_id: str) -> None:
        """Delete a subscription; what waits is not sent."""
        self._connection.send("DELETE", _webhook(webhook_id))

    def rotate(self, webhook_id: str) -> Webhook:
        """Replace the secret and return the new one; the old one signs too for a day."""
        return Webhook.from_json(self._connection.json("POST", _webhook(webhook_id) + ":rotate"))

    def ping(self, webhook_id: str) -> Delivery:
        """Send a message of type "ping"; `delivery(id)` says how that went."""
        return Delivery.from_json(self._connection.json("POST", _webhook(webhook_id) + ":ping"))

    def deliveries(
        self, *, webhook_id: str = "", job_id: str = "", state: str = "", limit: int = 0
    ) -> Iterator[Delivery]:
        """Return deliveries, newest first; `limit` 0 means all.

        `state` is "pending", "delivered" or "failed".
        """
        given = {"webhook": webhook_id, "job": job_id, "state": state}
        params = {name: value for name, value in given.items() if arguments.text(value, name)}
        limit = arguments.whole(limit, "limit", 0)
        pages = self._connection.pages("/v1/deliveries", params)
        return map(Delivery.from_json, islice(pages, limit or None))

    def delivery(self, delivery_id: str) -> Delivery:
        """Return a delivery with its attempts."""
        path = f"/v1/deliveries/{arguments.identifier(delivery_id, 'delivery_id')}"
        return Delivery.from_json(self._connection.json("GET", path))

    def redeliver(self, delivery_id: str) -> Delivery:
        """Deliver again, with the same id and body."""
        path = f"/v1/deliveries/{arguments.identifier(delivery_id, 'delivery_id')}:redeliver"
        return Delivery.from_json(self._connection.json("POST", path, repeatable=True))

    def job_secret(self) -> str:
        """Return the secret that signs what jobs submitted with a `webhook` of their own send."""
        return str(self._connection.json("GET", "/v1/webhook-secret")["secret"])
