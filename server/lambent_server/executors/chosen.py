"""The executor that the settings ask for."""

import importlib.util

from lambent_core.extras import pip_install

from lambent_server.core.settings import Settings
from lambent_server.executors import Executor
from lambent_server.executors.groups import groups_or_none
from lambent_server.executors.local import LocalExecutor


class ExecutorSetupError(Exception):
    """The executor cannot be used; the message says why and what to do."""


def open_executor(settings: Settings, secret: str) -> Executor:
    """Return the executor, ready to start runs; raises ExecutorSetupError.

    A Ray cluster that does not answer yet is no error: runs start when it does.
    """
    if settings.executor == "local":
        return LocalExecutor(settings, groups_or_none())
    if importlib.util.find_spec("ray") is None:
        raise ExecutorSetupError(f"serve.ray_missing: Ray is not installed; {pip_install('server', 'ray')}")
    if settings.ray_address is None:
        raise ExecutorSetupError(
            "serve.ray_address_missing: set LAMBENT_RAY_ADDRESS to the cluster, such as 10.0.0.5:6379"
        )
    if settings.worker_address is None:
        raise ExecutorSetupError(
            "serve.ray_needs_worker_address: runs on other machines reach this server at "
            "LAMBENT_WORKER_ADDRESS, which is not set"
        )
    if settings.ray_token_file is not None and not settings.ray_token_file.is_file():
        raise ExecutorSetupError(f"serve.ray_token_missing: there is no file {settings.ray_token_file}")
    from lambent_server.executors.ray import RayExecutor
    from lambent_server.executors.ray_cluster import probe

    if not settings.ray_without_token and probe(settings.ray_address) == "open":
        raise ExecutorSetupError(
            f"serve.ray_without_token: {settings.ray_address} runs the programs of everybody who can reach "
            "it; start the cluster with RAY_AUTH_MODE=token, or, if its network protects it, set "
            "LAMBENT_RAY_WITHOUT_TOKEN=true"
        )
    executor = RayExecutor(settings, secret)
    executor.open()
    return executor
