"""For receivers of webhooks: whether a request really comes from the server, and is not an old one again."""

import base64
import binascii
import hashlib
import hmac
import json
import time
from collections.abc import Mapping, Sequence
from typing import Any

from lambent.errors import LambentError

TOLERANCE_S = 300.0
"""How old a delivery may be, and how far ahead its clock."""
_PREFIX = "whsec_"


class WebhookVerificationError(LambentError):
    """A request is not a delivery of the server whose secret this is; answer it with 400."""


def verify(
    secret: str | Sequence[str],
    headers: Mapping[str, str],
    body: bytes,
    *,
    tolerance_s: float = TOLERANCE_S,
    now_s: float | None = None,
) -> dict[str, Any]:
    """Return the message of a delivery, having checked its signature and its age.

    `body` are the bytes as they came, before any parser; `headers` may have any case of letters. With several
    secrets one of them has to fit. A message may come more than once, for it is repeated until it is answered
    with 2xx: keep the ids (`webhook-id`) of those that were dealt with. Raises `WebhookVerificationError`
    with the codes `webhook.headers`, `webhook.timestamp`, `webhook.signature` and `webhook.body`.
    Source: the Standard Webhooks specification, symmetric signatures.
    """
    known = {name.lower(): value for name, value in headers.items()}
    try:
        identifier, stamp, given = (known[f"webhook-{name}"] for name in ("id", "timestamp", "signature"))
    except KeyError as error:
        raise _refused("headers", f"the header {error.args[0]} is missing") from error
    if not (stamp.isascii() and stamp.isdecimal() and len(stamp) <= 12):
        raise _refused("timestamp", f"{stamp[:40]!r} is not a time in Unix seconds")
    age_s = (time.time() if now_s is None else now_s) - int(stamp)
    if abs(age_s) > tolerance_s:
        raise _refused("timestamp", f"the delivery is {age_s:.0f} s old, and {tolerance_s:g} s are allowed")
    signed = f"{identifier}.{stamp}.".encode() + body
    keys = [_key(each) for each in ([secret] if isinstance(secret, str) else secret)]
    expected = [hmac.new(key, signed, hashlib.sha256).digest() for key in keys]
    # All are compared, so that the time says nothing.
    matches = [hmac.compare_digest(mine, theirs) for mine in expected for theirs in _signatures(given)]
    if not any(matches):
        raise _refused("signature", "no signature fits: another secret, or a body that was changed or parsed")
    try:
        message = json.loads(body)
    except ValueError as error:
        raise _refused("body", f"the body is not JSON: {error}") from error
    return dict(message)


def _key(secret: str) -> bytes:
    try:
        return base64.b64decode(secret.removeprefix(_PREFIX), validate=True)
    except binascii.Error as error:
        raise ValueError("a secret of a webhook is whsec_ and base64") from error


def _signatures(header: str) -> list[bytes]:
    """Return the symmetric signatures of a header; those of other versions are left out."""
    decoded = []
    for word in header.split()[:16]:
        version, comma, text = word.partition(",")
        if version == "v1" and comma:
            try:
                decoded.append(base64.b64decode(text, validate=True))
            except (binascii.Error, ValueError):
                continue
    return decoded


def _refused(code: str, message: str) -> WebhookVerificationError:
    return WebhookVerificationError(
        f"webhook.{code}", message, "answer with 400; a repeat brings the same bytes"
    )
