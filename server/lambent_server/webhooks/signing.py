"""Signatures of webhooks, as the Standard Webhooks specification describes them (symmetric, `v1`)."""

import base64
import hashlib
import hmac
import secrets
from collections.abc import Sequence

PREFIX = "whsec_"
_SECRET_BYTES = 32


def new_signing_secret() -> str:
    """Return a new secret: 256 random bits in base64 after a prefix."""
    return PREFIX + base64.b64encode(secrets.token_bytes(_SECRET_BYTES)).decode()


def signature(secret: str, identifier: str, timestamp: int, body: bytes) -> str:
    """Return the signature of a delivery by one secret."""
    key = base64.b64decode(secret.removeprefix(PREFIX))
    signed = f"{identifier}.{timestamp}.".encode() + body
    return "v1," + base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()


def signed_headers(
    active_secrets: Sequence[str], identifier: str, timestamp: int, body: bytes
) -> dict[str, str]:
    """Return the headers that identify a delivery; one signature for each secret, separated by spaces."""
    return {
        "webhook-id": identifier,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": " ".join(
            signature(secret, identifier, timestamp, body) for secret in active_secrets
        ),
    }
