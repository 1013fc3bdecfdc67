"""Client of a Lambent server: `Client` and the types it returns, and the `lambent` command.

Nothing is imported before it is used, so that `lambent --help` stays fast.
"""

import importlib
from typing import TYPE_CHECKING

# For programs that check types; `__getattr__` does the same when a name is used.
if TYPE_CHECKING:
    from lambent.client import Client
    from lambent.errors import (
        DigestMismatchError,
        JobNotSucceededError,
        LambentError,
        PointerError,
        RefusedError,
        ServerFaultError,
        UnreachableError,
        UsageProblemError,
        WaitTimeoutError,
    )
    from lambent.fetch import FetchedBundle
    from lambent.models import (
        Artifact,
        Batch,
        Delivery,
        Environment,
        Event,
        Finding,
        Job,
        JobError,
        Progress,
        Scene,
        SceneReport,
        Share,
        Webhook,
    )
    from lambent.settings import ServerAddress
    from lambent.webhooks import WebhookVerificationError

__version__ = "0.1.0"

_HOMES = {
    "Client": "client",
    "Artifact": "models",
    "Batch": "models",
    "Delivery": "models",
    "Environment": "models",
    "Event": "models",
    "Job": "models",
    "JobError": "models",
    "Progress": "models",
    "Finding": "models",
    "Scene": "models",
    "SceneReport": "models",
    "Share": "models",
    "Webhook": "models",
    "WebhookVerificationError": "webhooks",
    "FetchedBundle": "fetch",
    "ServerAddress": "settings",
    "DigestMismatchError": "errors",
    "JobNotSucceededError": "errors",
    "LambentError": "errors",
    "PointerError": "errors",
    "RefusedError": "errors",
    "ServerFaultError": "errors",
    "UnreachableError": "errors",
    "UsageProblemError": "errors",
    "WaitTimeoutError": "errors",
}

__all__ = [
    "Artifact",
    "Batch",
    "Client",
    "Delivery",
    "DigestMismatchError",
    "Environment",
    "Event",
    "FetchedBundle",
    "Finding",
    "Job",
    "JobError",
    "JobNotSucceededError",
    "LambentError",
    "PointerError",
    "Progress",
    "RefusedError",
    "Scene",
    "SceneReport",
    "ServerAddress",
    "ServerFaultError",
    "Share",
    "UnreachableError",
    "UsageProblemError",
    "WaitTimeoutError",
    "Webhook",
    "WebhookVerificationError",
    "__version__",
]


def __getattr__(name: str) -> object:
    """Return a public name, importing its module on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted(__all__)
