"""Bodies of the REST interface for webhooks, and what is sent to their receivers."""

from typing import Annotated, Any, Literal

from lambent_core.pictures import Name
from pydantic import AfterValidator, Field

from lambent_server.api.change_messages import LabelChange
from lambent_server.api.messages import ONLY_THESE, Given, LabelName, Shown
from lambent_server.api.parameters import SettingValue

PING = "ping"
EventType = Literal[
    "job.queued",
    "job.running",
    "job.cancelling",
    "job.retry_wait",
    "job.succeeded",
    "job.failed",
    "job.cancelled",
]
ENDS: tuple[EventType, ...] = ("job.succeeded", "job.failed", "job.cancelled")
DeliveryState = Literal["pending", "delivered", "failed"]
Url = Annotated[str, Field(min_length=1, max_length=2000)]
Labels = Annotated[dict[LabelName, SettingValue], Field(max_length=32, json_schema_extra=ONLY_THESE)]
Events = Annotated[
    list[EventType], Field(min_length=1, max_length=7), AfterValidator(lambda given: sorted(set(given)))
]


class NewWebhook(Given):
    """A standing subscription to changes of jobs."""

    url: Url
    name: Name = "webhook"
    events: Annotated[Events, Field(default_factory=lambda: list(ENDS))]
    labels: Annotated[Labels, Field(default_factory=dict)]
    """Only jobs that have all of them; none: every job."""


class WebhookChange(Given):
    """What to change of a subscription; what is not given stays."""

    url: Url | None = None
    name: Name | None = None
    events: Events | None = None
    labels: LabelChange | None = None
    """Null removes one."""
    enabled: bool | None = None


class Webhook(Shown):
    """A standing subscription, without its secret."""

    id: str
    url: str
    name: str
    events: list[EventType]
    labels: dict[str, str]
    enabled: bool
    disabled_reason: Literal["", "asked", "gone", "maker_left"]
    """`gone`: the receiver answered 410. `maker_left`: whoever made it has left, or their key was revoked."""
    created_at: str


class WebhookList(Shown):
    """One page of subscriptions, newest first."""

    items: list[Webhook]
    next_cursor: str | None


class CreatedWebhook(Webhook):
    """A subscription with its secret, which no other answer contains."""

    secret: str
    """Signs every delivery; `whsec_` and base64."""


class SigningSecret(Shown):
    """The secret that signs the deliveries that jobs ask for themselves."""

    secret: str


class DeliveryAttempt(Shown):
    """One attempt to deliver."""

    at: str
    status: int | None
    """The status of the answer; null if there was none."""
    error: str
    """Why it failed: a code such as `timeout`, `connection_failed`, `address_refused` or `status`."""
    seconds: float


class Delivery(Shown):
    """One message to a receiver; its id is the header `webhook-id` of every attempt."""

    id: str
    webhook_id: str | None
    """Null if the job asked for it."""
    job_id: str | None
    """Null for a ping."""
    event: Literal[EventType, "ping"]
    url: str
    state: DeliveryState
    created_at: str
    next_at: str | None
    """When the next attempt is due."""
    ended_at: str | None
    num_attempts: int
    attempts: list[DeliveryAttempt]
    """The newest 20."""


class DeliveryList(Shown):
    """One page of deliveries, newest first."""

    items: list[Delivery]
    next_cursor: str | None


class DeliveredError(Shown):
    """Why a job failed, as receivers get it."""

    code: str
    message: str


class DeliveredJob(Shown):
    """A job at the time of a change, as receivers get it."""

    id: str
    kind: str
    state: str
    scene_id: str
    preset: str
    labels: dict[str, str]
    priority: int
    run: int
    seq: int
    """The number of the change in the history of the job: deliveries may arrive in another order."""
    bundle_id: str | None
    batch_id: str | None
    error: DeliveredError | None
    created_at: str
    finished_at: str | None


class DeliveredBody(Shown):
    """The body of every delivery."""

    type: Literal[EventType, "ping"]
    timestamp: str
    """When it happened."""
    data: DeliveredJob | dict[str, Any]
