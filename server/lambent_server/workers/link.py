"""Addresses at which run processes reach this server: a socket in its data folder, and one on the network."""

import os
import stat
import tempfile
from pathlib import Path

import grpc
import structlog

from lambent_server.cluster.certificates import Renewals, ServerAddress, certificate_for
from lambent_server.cluster.membership import Membership
from lambent_server.core.secrets import sha256_text
from lambent_server.core.settings import ServeError, Settings
from lambent_server.executors.local import host_identity
from lambent_server.services import Services
from lambent_server.workers.service import Listening, serve_workers

log = structlog.get_logger()

# Longest path of a Unix socket that every system accepts.
MAX_SOCKET_PATH = 100
# Refused as an address to call, not bound.
EVERYWHERE = frozenset({"0.0.0.0", "::", "*"})


def worker_address(settings: Settings) -> str:
    """Return the address at which run processes reach the server; the same after every restart."""
    path = (settings.data / "worker.sock").resolve()
    if len(os.fsencode(path)) > MAX_SOCKET_PATH:
        # A port would be open to every user of the machine; this folder is private.
        name = sha256_text(str(path))[:16]
        path = _private_folder(f"lambent-{os.getuid()}") / f"{name}.sock"
    path.unlink(missing_ok=True)
    return f"unix:{path}"


def network_address(settings: Settings) -> str:
    """Return where run processes of other machines reach this server."""
    kind = "tcp" if settings.worker_plain else "tls"
    if settings.worker_public_address is not None:
        return f"{kind}:{settings.worker_public_address}"
    if str(settings.worker_address).rpartition(":")[0].strip("[]") in EVERYWHERE:
        raise ServeError(
            f"serve.worker_address_unspecific: {settings.worker_address} stands for all addresses of this "
            "machine; set LAMBENT_WORKER_PUBLIC_ADDRESS to the one that other machines know"
        )
    return f"{kind}:{settings.worker_address}"


def _private_folder(name: str) -> Path:
    """Return a temporary folder that no other user can enter."""
    folder = Path(tempfile.gettempdir()).resolve() / name
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & 0o077:
        raise ServeError(
            f"serve.folder_not_private: {folder} has to be a folder of this user that nobody else can enter, "
            "for the socket of run processes; remove it, or choose a shorter folder with --data"
        )
    return folder


def open_workers(services: Services, secret: str) -> tuple[grpc.Server, Membership, ServerAddress]:
    """Start the service for run processes; return it, this server among the others, and how runs reach it."""
    settings, address = services.settings, worker_address(services.settings)
    membership = Membership(
        services.database, settings, host=host_identity(), gpus=lambda: services.capacity.max_gpus()
    )
    server_address, network, reached_at = ServerAddress(address=address), None, None
    try:
        if settings.worker_address is not None:
            reached_at = network_address(settings)
            if settings.worker_plain:
                log.warning("worker_link_plain", address=settings.worker_address)
                network = Listening(address=settings.worker_address, certificate=None)
            else:
                # Before the files are read, so that no change of them is missed.
                renewed = Renewals(settings)
                certificate = certificate_for(services.database, settings)
                server_address = ServerAddress(
                    address=address, authority=certificate.authority, authority_name=certificate.name
                )
                network = Listening(address=settings.worker_address, certificate=certificate, renewed=renewed)
        workers = serve_workers(services, secret, address, network=network, servers=membership.endpoints)
    except OSError as error:
        raise ServeError(
            f"serve.worker_address_unusable: {settings.worker_address or address} ({error}); choose another "
            "with LAMBENT_WORKER_ADDRESS"
        ) from error
    membership.own_endpoints = (address,) if reached_at is None else (address, reached_at)
    if membership.is_taken():
        raise ServeError(
            f"serve.server_twice: another server lives under the name {membership.id}, from a copy of "
            f"{settings.data}; remove server.id from the copy"
        )
    return workers, membership, server_address
