"""Client of a Lambent server: `Client` and the types it returns, and the `lambent` command.

Nothing is imported before it is used, so that `lambent --help` stays fast.
"""

import importlib
from typing import TYPE_CHECKING

# For programs that check types; `__getattr__` does the same when a name is used.
if TYPE_CHECKING:
    from lambent.client import Client as Client
    from lambent.errors import DigestMismatchError as DigestMismatchError
    from lambent.errors import JobNotSucceededError as JobNotSucceededError
    from lambent.errors import LambentError as LambentError
    from lambent.errors import PointerError as PointerError
    from lambent.errors import RefusedError as RefusedError
    from lambent.errors import ServerFaultError as ServerFaultError
    from lambent.errors import UnreachableError as UnreachableError
    from lambent.errors import UsageProblemError as UsageProblemError
    from lambent.errors import WaitTimeoutError as WaitTimeoutError
    from lambent.fetch import FetchedBundle as FetchedBundle
    from lambent.models import Artifact as Artifact
    from lambent.models import Batch as Batch
    from lambent.models import Delivery as Delivery
    from lambent.models import Environment as Environment
    from lambent.models import Event as Event
    from lambent.models import Finding as Finding
    from lambent.models import Job as Job
    from lambent.models import JobError as JobError
    from lambent.models import Progress as Progress
    from lambent.models import Scene as Scene
    from lambent.models import SceneReport as SceneReport
    from lambent.models import Share as Share
    from lambent.models import Webhook as Webhook
    from lambent.settings import ServerAddress as ServerAddress
    from lambent.webhooks import WebhookVerificationError as WebhookVerificationError

__version__ = "0.1.0"

_HOMES = {
    name: home
    for home, names in {
        "client": "Client",
        "errors": "DigestMismatchError JobNotSucceededError LambentError PointerError "
        "RefusedError ServerFaultError UnreachableError UsageProblemError WaitTimeoutError",
        "fetch": "FetchedBundle",
        "models": "Artifact Batch Delivery Environment Event Finding "
        "Job JobError Progress Scene SceneReport Share Webhook",
        "settings": "ServerAddress",
        "webhooks": "WebhookVerificationError",
    }.items()
    for name in names.split()
}
__all__ = ["__version__", *_HOMES]


def __getattr__(name: str) -> object:
    """Return a public name, importing its module on first use."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted(__all__)
