"""The kinds of executors, and the one that the settings ask for."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass

from lambent_core.errors import pip_install

from lambent_server.core.settings import ServeError, Settings
from lambent_server.executors import Executor
from lambent_server.executors.groups import groups_or_none
from lambent_server.executors.local import LocalExecutor


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """A kind of executor."""

    open: Callable[[Settings, str], Executor]
    """Return it ready to start runs; raises ServeError."""
    on_this_machine: bool
    """Whether its places are those of this machine; otherwise servers share them, and none owns them."""


def open_executor(settings: Settings, secret: str) -> Executor:
    """Return the executor, ready to start runs; raises ServeError."""
    return KINDS[settings.executor].open(settings, secret)


def is_on_this_machine(settings: Settings) -> bool:
    """Return whether runs have the places of this machine."""
    return KINDS[settings.executor].on_this_machine


def _open_local(settings: Settings, secret: str) -> Executor:
    return LocalExecutor(settings, groups_or_none())


def _open_ray(settings: Settings, secret: str) -> Executor:
    """Return the executor of a Ray cluster, which may answer later: runs start when it does."""
    if importlib.util.find_spec("ray") is None:
        raise ServeError(f"serve.ray_missing: Ray is not installed; {pip_install('server', 'ray')}")
    if settings.ray_address is None:
        raise ServeError(
            "serve.ray_address_missing: set LAMBENT_RAY_ADDRESS to the cluster, such as 10.0.0.5:6379"
        )
    if settings.worker_address is None:
        raise ServeError(
            "serve.ray_needs_worker_address: runs on other machines reach this server at "
            "LAMBENT_WORKER_ADDRESS, which is not set"
        )
    if settings.ray_token_file is not None and not settings.ray_token_file.is_file():
        raise ServeError(f"serve.ray_token_missing: there is no file {settings.ray_token_file}")
    from lambent_server.executors.ray import RayExecutor
    from lambent_server.executors.ray_cluster import probe

    if not settings.ray_without_token and probe(settings.ray_address) == "open":
        raise ServeError(
            f"serve.ray_without_token: {settings.ray_address} runs the programs of anyone who can reach "
            "it; start the cluster with RAY_AUTH_MODE=token, or, if its network protects it, set "
            "LAMBENT_RAY_WITHOUT_TOKEN=true"
        )
    executor = RayExecutor(settings, secret)
    executor.open()
    return executor


KINDS = {
    "local": Kind(open=_open_local, on_this_machine=True),
    "ray": Kind(open=_open_ray, on_this_machine=False),
}
"""The values of the setting `executor`."""
