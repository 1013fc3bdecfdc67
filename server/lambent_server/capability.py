"""Keys: the installation's secret, the run process's token made from it, and hashes of the rest."""

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
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        return path.read_text(encoding="ascii").strip()
    secret = prefix + secrets.token_urlsafe(32)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(secret + "\n")
    return secret


def run_token(secret: str, job_id: str, run: int) -> str:
    """Return what one run of one job proves itself with.

    It is derived, not stored, so that a stale run is recognised as such and not merely as a stranger.
    """
    return hmac.new(secret.encode(), f"{job_id}\n{run}".encode(), hashlib.sha256).hexdigest()
