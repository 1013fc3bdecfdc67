"""Client of a Lambent server: `Client` and the types it returns, and the `lambent` command.

Nothing is imported before it is used, so that `lambent --help` stays fast.
"""

import importlib

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
}

__all__ = [*_HOMES, "__version__"]


def __getattr__(name: str) -> object:
    """Return a public name, importing its module on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted(__all__)
