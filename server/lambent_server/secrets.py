"""Keys: the installation's secrets, the run process's token made from one, and hashes of the rest."""

import contextlib
import hashlib
import hmac
import os
import secrets
from pathlib import Path


class SecretError(Exception):
    """A secret's file that cannot be used; the text says what to do."""


def sha256_text(text: str) -> str:
    """Return the hash that is stored in place of a key, a code or a session."""
    return hashlib.sha256(text.encode()).hexdigest()


def new_secret(prefix: str = "") -> str:
    """Return 256 random bits as text."""
    return prefix + secrets.token_urlsafe(32)


def read_or_create_secret(path: Path, prefix: str = "") -> str:
    """Return the secret in `path`, making one that only its owner can read where there is none.

    Raises SecretError for a file without a secret: an empty one would open the server to everybody.
    """
    if not path.exists():
        write_secret(path, new_secret(prefix))
    with contextlib.suppress(UnicodeDecodeError):
        if secret := path.read_text(encoding="ascii").strip():
            return secret
    raise SecretError(
        f"serve.secret_invalid: {path} holds no secret; remove it and start again, which makes a new one"
    )


def write_secret(path: Path, secret: str, *, replace: bool = False) -> None:
    """Write a file that only its owner can read; one that is there is kept unless it is to be replaced.

    Under its name it is never seen empty, nor after a power cut.
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
    """Return what one run of one job proves itself with.

    It is derived, not stored, so that a stale run is recognised as such and not merely as a stranger. It
    names the run, so that it can be judged before anything else of a request is read.
    """
    proof = hmac.new(secret.encode(), f"{job_id}\n{run}".encode(), hashlib.sha256).hexdigest()
    return f"{job_id}.{run}.{proof}"


def is_run_token(secret: str, token: str) -> bool:
    """Return whether a token is that of some run."""
    job_id, _, rest = token.partition(".")
    run = rest.partition(".")[0]
    return run.isdecimal() and hmac.compare_digest(token, run_token(secret, job_id, int(run)))
