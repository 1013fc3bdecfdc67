"""The order of a job, as `Client.submit` takes it."""

from collections.abc import Mapping
from typing import Any, TypedDict

from lambent import arguments


class JobOrder(TypedDict, total=False):
    """What may be said of a job; everything has a default."""

    preset: str
    """"fast" where none is named."""
    params: Mapping[str, str] | None
    """Settings over the preset, such as {"stage_one.num_rays": "512"}."""
    seed: int
    kind: str
    """"train"; "prepare" finds cameras and masks only, "check" looks at the capture."""
    gpus: int | None
    """None leaves the number to the preset."""
    priority: int
    labels: Mapping[str, str] | None
    webhook: str
    """Where the server tells that the job has ended (see `Client.webhooks`)."""


def order_body(order: JobOrder) -> dict[str, Any]:
    """Return an order for `POST /v1/jobs`; raises `client.argument`, or TypeError for other names."""
    if unknown := order.keys() - JobOrder.__annotations__.keys():
        raise TypeError(f"submit() got an unexpected keyword argument {min(unknown)!r}")
    gpus, webhook = order.get("gpus"), order.get("webhook", "")
    return {
        "preset": arguments.text(order.get("preset", "fast"), "preset"),
        "params": arguments.texts(order.get("params"), "params"),
        "seed": arguments.whole(order.get("seed", 0), "seed", 0),
        "kind": arguments.text(order.get("kind", "train"), "kind"),
        **({} if gpus is None else {"gpus": arguments.whole(gpus, "gpus", 0)}),
        "priority": arguments.whole(order.get("priority", 0), "priority"),
        "labels": arguments.texts(order.get("labels"), "labels"),
        **({"webhook": arguments.text(webhook, "webhook")} if webhook else {}),
    }
