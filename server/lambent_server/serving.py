"""One server process from start to end: HTTP, worker service and controller on the same parts."""

import asyncio
import contextlib
import fcntl
import json
import os
import re
import resource
import signal
import socket
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog
from alembic.util import CommandError
from fastapi import FastAPI
from granian.constants import HTTPModes, Interfaces
from granian.http import HTTP1Settings
from granian.server.embed import Server as Granian
from obstore.exceptions import BaseError
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.app import LOOPBACK, make_app
from lambent_server.controller import Controller
from lambent_server.database.tenancy import DEFAULT_TENANT_ID, Tenant
from lambent_server.executors.local import LocalExecutor
from lambent_server.http.middleware import App
from lambent_server.keys import FILE, accept_file
from lambent_server.reconciler import Reconciler
from lambent_server.secrets import SecretError, read_or_create_secret, sha256_text
from lambent_server.services import Services, open_services
from lambent_server.settings import Settings
from lambent_server.worker_service import serve_workers

log = structlog.get_logger()

# Longest path of a Unix socket that every system accepts.
MAX_SOCKET_PATH = 100
# Open files of a server besides client connections: database, uploads, run processes.
OTHER_FILES = 512


class ServeError(Exception):
    """The server cannot start; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class Ready:
    """The addresses to print once the server answers."""

    url: str
    login_url: str
    key_file: Path


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


def allow_connections(wanted: int) -> int:
    """Raise the limit of open files for `wanted` connections; return how many are possible."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    limit = wanted + OTHER_FILES if hard == resource.RLIM_INFINITY else min(wanted + OTHER_FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < limit:
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
    return max(min(wanted, limit - OTHER_FILES), 16)


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


def worker_address(settings: Settings) -> str:
    """Return the address at which run processes reach the server; the same after every restart."""
    path = (settings.data / "worker.sock").resolve()
    if len(os.fsencode(path)) > MAX_SOCKET_PATH:
        # A port would be open to every user of the machine; this folder is private.
        name = sha256_text(str(path))[:16]
        path = _private_folder(f"lambent-{os.getuid()}") / f"{name}.sock"
    path.unlink(missing_ok=True)
    return f"unix:{path}"


def _private_folder(name: str) -> Path:
    """Return a temporary folder that no other user can enter."""
    folder = Path(tempfile.gettempdir()).resolve() / name
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ServeError(
            f"serve.folder_not_private: {folder} has to be a folder of this user that nobody else can enter, "
            "for the socket of run processes; remove it, or choose a shorter folder with --data"
        )
    return folder


def _write_whole(path: Path, data: Any) -> None:
    partial = path.with_suffix(".tmp")
    partial.write_text(json.dumps(data) + "\n", encoding="utf-8")
    partial.replace(path)


async def run(settings: Settings, on_ready: Any) -> None:
    """Run the server until SIGTERM or SIGINT.

    SIGTERM leaves run processes running: the next server adopts them. SIGINT (Ctrl-C) stops them too, after a
    checkpoint if they can write one.
    """
    check_address(settings)
    with sole_user(settings.data):
        port = settings.port or free_port(settings.host)
        require_free(settings.host, port)
        services, app, gate, secret = _open(settings)
        try:
            await _serve(services, app, gate, secret, port, on_ready)
        finally:
            services.database.close()


def _open(settings: Settings) -> tuple[Services, FastAPI, App, str]:
    """Return the parts, the application, the same wrapped in its gate, and the secret of run processes."""
    try:
        services = open_services(settings)
        accept_file(services.database, Tenant(DEFAULT_TENANT_ID), settings.data)
        return services, *make_app(services), read_or_create_secret(settings.data / "worker.secret")
    except SecretError as error:
        raise ServeError(str(error)) from error
    except OSError as error:
        raise _data_unusable(settings.data, error) from error
    except (SQLAlchemyError, CommandError) as error:
        # The password must not appear in a message.
        url = re.sub(r"//[^/@]*@", "//...@", settings.database_url)
        raise ServeError(
            f"serve.database_unusable: {url} cannot be used ({str(error).splitlines()[0]}); check that "
            "it exists and is running, and that no newer version of Lambent has used it"
        ) from error
    except (ValueError, BaseError) as error:
        raise ServeError(
            f"serve.store_unusable: {settings.store} cannot be used ({str(error).splitlines()[0]}); give a "
            "URL that obstore knows, such as file:///folder or s3://bucket"
        ) from error


async def _serve(services: Services, app: FastAPI, gate: App, secret: str, port: int, on_ready: Any) -> None:
    settings = services.settings
    loop = asyncio.get_running_loop()
    ended: asyncio.Future[int] = loop.create_future()

    def end(number: int) -> None:
        if not ended.done():
            ended.set_result(number)

    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, end, number)

    tenant = Tenant(DEFAULT_TENANT_ID)
    address = worker_address(settings)
    workers = serve_workers(services, secret, address)
    controller = Controller(services, LocalExecutor(settings), secret=secret, address=address)
    controller.start()
    app.state.controller = controller
    app.state.reconciler = reconciler = Reconciler(services)
    reconciler.start()
    server = Granian(
        gate,
        address=settings.host,
        port=port,
        interface=Interfaces.ASGINL,
        http=HTTPModes.http1,
        websockets=False,
        log_enabled=False,
        backlog=1024,
        backpressure=allow_connections(settings.max_connections),
        http1_settings=HTTP1Settings(header_read_timeout=int(settings.header_timeout_s * 1000)),
    )
    serving = loop.create_task(server.serve())
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    url = f"http://{host}:{port}"
    await _until_listening(settings.host, port, serving)
    _write_whole(settings.data / "server.json", {"url": url, "pid": os.getpid()})
    code, _ = app.state.login_codes.issue(tenant)
    on_ready(Ready(url, f"{url}/#code={code}", settings.data / FILE))
    log.info("serving", url=url, data=str(settings.data))

    await asyncio.wait({ended, serving}, return_when=asyncio.FIRST_COMPLETED)
    interrupted = ended.done() and ended.result() == signal.SIGINT
    log.info("ending", stop_runs=interrupted)
    (settings.data / "server.json").unlink(missing_ok=True)
    services.wakeups.close()
    # Run processes that are asked to stop still commit their checkpoint, so their service stops after them.
    await asyncio.to_thread(controller.close, stop_runs=interrupted)
    await asyncio.to_thread(reconciler.close)
    server.stop()
    with contextlib.suppress(TimeoutError):
        await asyncio.wait_for(serving, settings.shutdown_grace_s / 4)
    await asyncio.to_thread(workers.stop(1).wait)
    log.info("ended")


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
