"""Keys: the installation's secret, the run process's token made from it, and hashes of the rest."""

import contextlib
import hashlib
import hmac
import os
import secrets
from pathlib import Path


def sha256_text(text: str) -> str:
    """Return the hash that is stored in place of a key, a code or a session."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_or_create_secret(path: Path, prefix: str = "") -> str:
    """Return the secret in `path`, making one that only its owner can read where there is none."""
    if not path.exists():
        secret = prefix + secrets.token_urlsafe(32)
        # Under its name it is never seen empty, and never readable by others.
        partial = path.with_name(f"{path.name}.{os.getpid()}.tmp")
        with os.fdopen(os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
            file.write(secret + "\n")
        with contextlib.suppress(FileExistsError):
            os.link(partial, path)
        partial.unlink()
    return path.read_text(encoding="ascii").strip()


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
