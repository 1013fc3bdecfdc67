"""One server process from start to end: HTTP, worker service and controller on the same parts."""

import asyncio
import contextlib
import fcntl
import gc
import os
import re
import resource
import signal
import socket
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog
from alembic.util import CommandError
from fastapi import FastAPI
from granian.constants import HTTPModes, Interfaces
from granian.http import HTTP1Settings
from granian.server.embed import Server as Granian
from lambent_core.files import write_json
from lambent_sandbox.sandbox import REQUIRED, Layers
from obstore.exceptions import BaseError
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.accounts.keys import FILE, accept_file
from lambent_server.api.problems import Problem
from lambent_server.app import LOOPBACK, make_app
from lambent_server.cluster.shared_secrets import WORKER, shared_secret
from lambent_server.core.settings import ServeError, Settings
from lambent_server.database.revision import SchemaTooNewError, UnreleasedSchemaError
from lambent_server.database.tenancy import DEFAULT_TENANT_ID, Tenant
from lambent_server.executors.chosen import open_executor
from lambent_server.http.identity import issue_login_code
from lambent_server.http.login_header import LoginHeader, login_secret
from lambent_server.http.proxies import Proxies
from lambent_server.http.request import App
from lambent_server.jobs.logs import LogCopier
from lambent_server.maintenance.compression import Compressor
from lambent_server.maintenance.scrubber import Scrubber
from lambent_server.running.controller import Controller
from lambent_server.running.reconciler import Reconciler
from lambent_server.services import Services, open_database, open_services
from lambent_server.storage import decoding
from lambent_server.storage.s3 import StoreSetupError
from lambent_server.webhooks.sender import Sender
from lambent_server.workers.connections import Connections
from lambent_server.workers.link import open_workers

log = structlog.get_logger()

# Open files of a server besides those of its clients: database, run processes, logs.
OTHER_FILES = 512
MIN_CONNECTIONS = 16
# How long a thread waits for the interpreter while the event loop is busy; by default ten times as long.
SWITCH_S = 0.0005
# New objects, and collections of younger objects, before a garbage collection.
COLLECT_AFTER = (5000, 20, 20)
# Connections that the system accepts before the server does; it may allow fewer (net.core.somaxconn).
BACKLOG = 4096


@dataclass(frozen=True, slots=True)
class Ready:
    """The addresses to print once the server answers."""

    url: str
    login_url: str
    key_file: Path | None
    """None if another server on the database has the key."""


def check_address(settings: Settings) -> None:
    """Refuse an address that other machines can reach without TLS, unless that is allowed."""
    if settings.host not in LOOPBACK and not settings.insecure:
        raise ServeError(
            f"serve.insecure_address: {settings.host} can be reached from other machines and nothing is "
            "encrypted; add --insecure if a proxy or the network protects it, or use --host 127.0.0.1"
        )


@contextlib.contextmanager
def sole_user(folder: Path) -> Iterator[None]:
    """Lock the data folder for this process."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        lock = (folder / "server.lock").open("a")
    except OSError as error:
        raise _data_unusable(folder, error) from error
    with lock as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise ServeError(
                f"serve.data_in_use: another server uses {folder} (see server.json there); stop it, or "
                "choose another folder with --data"
            ) from error
        yield


def _data_unusable(folder: Path, error: OSError) -> ServeError:
    return ServeError(
        f"serve.data_unusable: {error.filename or folder}: {error.strerror}; let this user write there, or "
        "choose another folder with --data"
    )


def allow_connections(settings: Settings) -> int:
    """Raise the limit of open files for the connections of the settings; return how many are possible."""
    wanted = settings.max_connections
    # Every upload has a file, and so may every other request.
    files = wanted + settings.max_bodies + settings.max_requests + OTHER_FILES
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = files if hard == resource.RLIM_INFINITY else min(files, hard)
    if soft != resource.RLIM_INFINITY and soft < limit:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
    if limit == files:
        return wanted
    possible = max(wanted * (limit - OTHER_FILES) // (files - OTHER_FILES), MIN_CONNECTIONS)
    log.warning("connections_limited", possible=possible, wanted=wanted, open_files=hard, needed=files)
    return possible


def require_sandbox(settings: Settings) -> Layers:
    """Return the layers around processes that decode uploads; refuse to start if the settings want more."""
    try:
        layers = decoding.probe(settings)
    except Problem as problem:
        raise ServeError(f"serve.sandbox_unusable: {problem.detail}; see LAMBENT_DECODE_COMMAND") from problem
    if layers.missing and settings.sandbox == REQUIRED:
        missing = ", ".join(f"{name} ({reason})" for name, reason in layers.missing.items())
        raise ServeError(
            f"serve.sandbox_missing: this system lacks {missing}, and LAMBENT_SANDBOX is required; set it to "
            "available to decode uploads with the layers that exist"
        )
    return layers


def free_port(host: str) -> int:
    """Return an unused port."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def require_free(host: str, port: int) -> None:
    """Refuse a port that is in use, before anything is started."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise ServeError(
                f"serve.port_in_use: {host}:{port} cannot be used ({error.strerror}); choose another with "
                "--port, 0 takes any free one"
            ) from error


@dataclass(frozen=True, kw_only=True, slots=True)
class Site:
    """What one server serves, and where."""

    services: Services
    app: FastAPI
    gate: App
    """The application behind the layer that checks every request."""
    secret: str
    """Authenticates run processes."""
    port: int
    connections: int
    """How many the system allows at the same time."""

    @property
    def url(self) -> str:
        """Return the address of the server."""
        host = self.services.settings.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}"


async def run(settings: Settings, on_ready: Callable[[Ready], None]) -> None:
    """Run the server until SIGTERM or SIGINT.

    SIGTERM leaves run processes running: the next server adopts them. SIGINT (Ctrl-C) stops them too, after a
    checkpoint if they can write one.
    """
    check_address(settings)
    sys.setswitchinterval(SWITCH_S)
    with _explained(settings):
        # Before the lock, which is a file in the data folder.
        open_database(settings).close()
    with sole_user(settings.data):
        port = settings.port or free_port(settings.host)
        require_free(settings.host, port)
        connections = allow_connections(settings)
        layers = require_sandbox(settings)
        site = _open(settings, port, connections)
        site.app.state.sandbox = layers
        # Not before: a server that cannot start says that first.
        tell = log.warning if layers.missing else log.info
        tell("sandbox", in_force=list(layers.in_force), missing=layers.missing)
        try:
            await _serve(site, on_ready)
        finally:
            site.services.database.close()


def _open(settings: Settings, port: int, connections: int) -> Site:
    with _explained(settings):
        services = open_services(settings)
        secret = shared_secret(services.database, settings, WORKER)
        accept_file(services.database, Tenant(DEFAULT_TENANT_ID), settings.data)
        login_secret(settings)
        app, gate = make_app(services, connections)
    return Site(services=services, app=app, gate=gate, secret=secret, port=port, connections=connections)


@contextlib.contextmanager
def _explained(settings: Settings) -> Iterator[None]:
    """Say which part of the settings cannot be used, and what to do."""
    try:
        yield
    except UnreleasedSchemaError as error:
        raise ServeError(f"serve.data_unreleased: {error}") from error
    except OSError as error:
        raise _data_unusable(settings.data, error) from error
    except (SQLAlchemyError, CommandError, SchemaTooNewError) as error:
        # The password must not appear in a message.
        url = re.sub(r"//[^/@]*@", "//...@", settings.database_url)
        raise ServeError(
            f"serve.database_unusable: {url} cannot be used ({str(error).splitlines()[0]}); check that "
            "it exists and is running, and that no newer version of Lambent has used it"
        ) from error
    except StoreSetupError as error:
        raise ServeError(f"serve.store_unusable: {error}") from error
    except (ValueError, BaseError) as error:
        raise ServeError(
            f"serve.store_unusable: {settings.store} cannot be used ({str(error).splitlines()[0]}); give a "
            "URL that obstore knows, such as file:///folder or s3://bucket"
        ) from error


def _ease_collection() -> None:
    """Spare the objects of the start, modules above all, from every garbage collection from now on.

    With thousands of streams, a full collection of everything stops the server for half a second.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*COLLECT_AFTER)


def end_signal(loop: asyncio.AbstractEventLoop) -> asyncio.Future[int]:
    """Return a future of the first SIGTERM or SIGINT from now on."""
    ended: asyncio.Future[int] = loop.create_future()

    def end(number: int) -> None:
        if not ended.done():
            ended.set_result(number)

    def wake(number: int, _frame: Any) -> None:
        loop.call_soon_threadsafe(end, number)

    # Not loop.add_signal_handler: it loses signals that come while a few hundred connections have news, for
    # the loop learns of both through one pipe, which is full then.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, wake)
    return ended


async def _serve(site: Site, on_ready: Callable[[Ready], None]) -> None:
    services, settings, state = site.services, site.services.settings, site.app.state
    ended = end_signal(asyncio.get_running_loop())
    workers, membership, server_address = open_workers(services, site.secret)
    try:
        executor = await asyncio.to_thread(open_executor, settings, site.secret)
    except ServeError:
        workers.stop(None)
        raise
    services.capacity.max_gpus, services.capacity.num_places = executor.max_gpus, executor.num_places
    controller = Controller(services, executor, membership, secret=site.secret, server_address=server_address)
    membership.start(site.url)
    reconciler = Reconciler(services, lambda: membership.leads)
    compressor, scrubber = (kind(services, lambda: membership.leads) for kind in (Compressor, Scrubber))
    copier, sender = LogCopier(services, membership), Sender(services, lambda: membership.leads)
    for thread in (controller, reconciler, compressor.rounds, scrubber.rounds, copier, sender):
        thread.start()
    state.controller, state.reconciler = controller, reconciler
    server, watching = _listen(site)
    serving = asyncio.create_task(server.serve())
    await _until_listening(settings.host, site.port, serving)
    _ease_collection()
    on_ready(_announce(site))

    await asyncio.wait({ended, serving}, return_when=asyncio.FIRST_COMPLETED)
    interrupted = ended.done() and ended.result() == signal.SIGINT
    log.info("ending", stop_runs=interrupted)
    _address_file(settings).unlink(missing_ok=True)
    services.wakeups.close()
    for task in watching:
        task.cancel()
    await asyncio.to_thread(sender.close)
    # Run processes that are asked to stop still commit their checkpoint, so their service stops after them.
    await asyncio.to_thread(controller.close, stop_runs=interrupted)
    for part in (compressor.rounds, scrubber.rounds, copier, reconciler, membership):
        await asyncio.to_thread(part.close)
    server.stop()
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(serving, settings.shutdown_grace_s / 4)
    await asyncio.to_thread(workers.stop(1).wait)
    await asyncio.to_thread(executor.close)
    log.info("ended")


def _listen(site: Site) -> tuple[Granian, list[asyncio.Task[None]]]:
    """Return the HTTP server, and the tasks that watch its connections and the database's announcements."""
    services, settings, gate = site.services, site.services.settings, site.gate
    if settings.trusted_proxies:
        gate = LoginHeader(Proxies(gate, settings.trusted_proxies), settings)
    outermost = Connections(gate, site.port, site.app.state.budget, settings.trusted_proxies)
    server = Granian(
        outermost,
        address=settings.host,
        port=site.port,
        interface=Interfaces.ASGINL,
        http=HTTPModes.http1,
        websockets=False,
        log_enabled=False,
        backlog=BACKLOG,
        backpressure=site.connections,
        http1_settings=HTTP1Settings(header_read_timeout=int(settings.header_timeout_s * 1000)),
    )
    watching = [asyncio.create_task(outermost.watch())]
    if not services.database.is_sqlite:
        from .database.listening import Listener

        listener = Listener(settings.listening_url, services.database, services.wakeups.signal)
        watching.append(asyncio.create_task(listener.run()))
    return server, watching


def _address_file(settings: Settings) -> Path:
    return settings.data / "server.json"


def _announce(site: Site) -> Ready:
    """Write where the server is for other programs of this machine, and return the addresses to print."""
    settings, database = site.services.settings, site.services.database
    write_json(_address_file(settings), {"url": site.url, "pid": os.getpid()})
    with database.write() as connection:
        code, _ = issue_login_code(connection, Tenant(DEFAULT_TENANT_ID), settings.login_code_s)
    key_file = settings.data / FILE
    log.info("serving", url=site.url, data=str(settings.data))
    return Ready(site.url, f"{site.url}/#code={code}", key_file if key_file.exists() else None)


async def _until_listening(host: str, port: int, serving: asyncio.Task[None]) -> None:
    while not serving.done():
        try:
            _, writer = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(0.02)
            continue
        writer.close()
        return
    serving.result()
    raise ServeError("serve.not_started: the HTTP server exited at once; see the log")
