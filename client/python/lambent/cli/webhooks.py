"""webhooks: subscriptions to changes of jobs."""

from typing import Annotated

import typer

from lambent.cli.jobs import parse_pairs
from lambent.cli.output import JsonOption, Output, UrlOption
from lambent.client import Client
from lambent.models import Delivery, Webhook

webhooks = typer.Typer(
    add_completion=False, no_args_is_help=True, help="Have changes of jobs told to an address of yours."
)
WebhookArgument = Annotated[str, typer.Argument(metavar="WEBHOOK", help="Id of a webhook.")]


def _line(webhook: Webhook) -> str:
    state = "enabled" if webhook.enabled else f"disabled ({webhook.disabled_reason})"
    return "\t".join((webhook.id, state, ",".join(webhook.events), webhook.url))


def _told(delivery: Delivery) -> str:
    last = delivery.attempts[-1] if delivery.attempts else {}
    how = last.get("error") or last.get("status") or "not yet tried"
    subject = delivery.job_id or "-"
    return "\t".join((delivery.id, delivery.state, delivery.event, subject, str(how), delivery.next_at))


@webhooks.command()
def create(
    receiver: Annotated[str, typer.Argument(metavar="URL", help="https address of the receiver.")],
    name: Annotated[str, typer.Option(help="A name to know it by.")] = "webhook",
    events: Annotated[
        list[str], typer.Option("--event", help="job.failed, ...; repeatable; else the ends of jobs.")
    ] = [],  # noqa: B006 - typer reads it once
    labels: Annotated[
        list[str], typer.Option("--label", metavar="KEY=VALUE", help="Only jobs with this label; repeatable.")
    ] = [],  # noqa: B006
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Subscribe, and print the id and the secret that signs the deliveries."""
    with Client(url) as client:
        made = client.webhooks.create(
            receiver, name=name, events=events, labels=parse_pairs(labels, "--label")
        )
    Output(as_json).result(f"{made.id}\t{made.secret}", made)


@webhooks.command("list")
def list_webhooks(url: UrlOption = "", as_json: JsonOption = False) -> None:
    """List subscriptions, newest first."""
    with Client(url) as client:
        for each in client.webhooks.list():
            Output(as_json).result(_line(each), each)


@webhooks.command()
def enable(webhook: WebhookArgument, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Send to a subscription again."""
    with Client(url) as client:
        changed = client.webhooks.change(webhook, enabled=True)
    Output(as_json).result(_line(changed), changed)


@webhooks.command()
def disable(webhook: WebhookArgument, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Send nothing more to a subscription until it is enabled."""
    with Client(url) as client:
        changed = client.webhooks.change(webhook, enabled=False)
    Output(as_json).result(_line(changed), changed)


@webhooks.command()
def delete(webhook: WebhookArgument, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Delete a subscription."""
    with Client(url) as client:
        client.webhooks.delete(webhook)
    Output(as_json).result(f"{webhook} deleted", {"deleted": webhook})


@webhooks.command()
def rotate(webhook: WebhookArgument, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Replace the secret and print the new one; the old one signs too for a day."""
    with Client(url) as client:
        fresh = client.webhooks.rotate(webhook)
    Output(as_json).result(fresh.secret, fresh)


@webhooks.command()
def ping(webhook: WebhookArgument, url: UrlOption = "", as_json: JsonOption = False) -> None:
    """Send a message of type ping, and print the id of the delivery."""
    with Client(url) as client:
        delivery = client.webhooks.ping(webhook)
    Output(as_json).result(delivery.id, delivery)


@webhooks.command()
def deliveries(
    webhook: Annotated[str, typer.Option(help="Only of this webhook.")] = "",
    job: Annotated[str, typer.Option(help="Only of this job.")] = "",
    state: Annotated[str, typer.Option(help="Only in this state: pending, delivered, failed.")] = "",
    limit: Annotated[int, typer.Option(help="How many at most; 0 for all.", min=0)] = 20,
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """List deliveries, newest first, with the outcome of the newest attempt."""
    with Client(url) as client:
        for each in client.webhooks.deliveries(webhook_id=webhook, job_id=job, state=state, limit=limit):
            Output(as_json).result(_told(each), each)


@webhooks.command()
def redeliver(
    delivery: Annotated[str, typer.Argument(metavar="DELIVERY", help="Id of a delivery.")],
    url: UrlOption = "",
    as_json: JsonOption = False,
) -> None:
    """Deliver again, with the same id and body."""
    with Client(url) as client:
        again = client.webhooks.redeliver(delivery)
    Output(as_json).result(f"{again.id} {again.state}", again)
