"""Secrets of the installation, the tokens of run processes derived from one, and hashes of keys and codes."""

import contextlib
import hashlib
import hmac
import os
import secrets
from collections.abc import Callable
from pathlib import Path

from lambent_server.core.settings import ServeError


def sha256_text(text: str) -> str:
    """Return the hash that is stored instead of a key, a code or a session token."""
    return hashlib.sha256(text.encode()).hexdigest()


def new_secret(prefix: str = "") -> str:
    """Return 256 random bits as text."""
    return prefix + secrets.token_urlsafe(32)


def read_or_create(path: Path, make: Callable[[], str] = new_secret) -> str:
    """Return the text in `path`, which only its owner can read; writes what `make` returns if there is none.

    Raises ServeError for a file without text: an empty secret would open the server to everyone.
    """
    if not path.exists():
        write_secret(path, make())
    with contextlib.suppress(UnicodeDecodeError):
        if secret := path.read_text(encoding="ascii").strip():
            return secret
    raise ServeError(
        f"serve.secret_invalid: {path} contains no secret; remove it and start again, which creates a new one"
    )


def write_secret(path: Path, secret: str, *, replace: bool = False) -> None:
    """Write a file that only its owner can read; an existing one is kept unless it is to be replaced.

    The file is never visible empty, not even after a power failure.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    partial.unlink(missing_ok=True)
    with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(secret + "\n")
        file.flush()
        os.fsync(file.fileno())
    if replace:
        partial.replace(path)
    else:
        with contextlib.suppress(FileExistsError):
            os.link(partial, path)
        partial.unlink()
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def run_token(secret: str, job_id: str, run: int) -> str:
    """Return the token that authenticates one run of one job.

    It is derived, not stored, so that a stale run is recognised as such and not just as unauthenticated. It
    names the run, so that it can be verified before anything else of a request is read.
    """
    proof = hmac.new(secret.encode(), f"{job_id}\n{run}".encode(), hashlib.sha256).hexdigest()
    return f"{job_id}.{run}.{proof}"


def is_run_token(secret: str, token: str) -> bool:
    """Return whether a token is valid for any run."""
    job_id, _, rest = token.partition(".")
    run = rest.partition(".")[0]
    return run.isdecimal() and is_token_of(secret, token, job_id, int(run))


def is_token_of(secret: str, token: str, job_id: str, run: int) -> bool:
    """Return whether a token is that of one run."""
    return hmac.compare_digest(token.encode(), run_token(secret, job_id, run).encode())
