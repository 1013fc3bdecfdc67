"""Proof that a bundle is whole, and where it is from: its files, the signed statement beside it, the key.

Works without a server. The statement is not inside the bundle, because every reader refuses files that its
manifest does not list: it is `NAME.relight.provenance.json` beside `NAME.relight`.
"""

import base64
import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lambent_core.errors import BundleError
from lambent_relight.bundle.archive import digest, open_source

from lambent.errors import LambentError, UsageProblemError

SUFFIX = ".provenance.json"
MANIFEST = "manifest.json"
PAYLOAD_TYPE = "application/vnd.in-toto+json"
_STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
_PREDICATE_TYPE = "https://slsa.dev/provenance/v1"
_MAX_STATEMENT_BYTES = 64 << 20


class TamperedError(LambentError):
    """The bundle, or the statement about it, is not what was signed."""

    exit_code = 1


@dataclass(frozen=True, kw_only=True, slots=True)
class Verified:
    """What is certain about a bundle."""

    num_files: int
    key_id: str
    """Of the key that has signed."""
    trusted: bool
    """Whether that is the key that was given; otherwise it is one of whoever wrote the statement."""
    made_by: str
    """The code: its name, version and revision."""
    started_on: str
    finished_on: str
    invocation: str
    """Job and run."""
    parameters: dict[str, Any] = field(default_factory=dict)
    inputs: dict[str, str] = field(default_factory=dict)
    """SHA-256 of each input, by path."""


def beside(bundle: Path) -> Path:
    """Return where the statement of a bundle is."""
    # "." and ".." do not name a folder.
    named = bundle.resolve() if bundle.name in ("", "..") else bundle
    return named.with_name(named.name + SUFFIX)


def verify(bundle: Path, *, statement: Path | None = None, key: Path | None = None) -> Verified:
    """Return what is certain about a bundle, a folder or a zip archive.

    `statement` is the file with the signed statement (else the one beside the bundle), and `key` a file with
    the public key of the server that you trust: PEM, or the answer of `GET /v1/provenance-key`. Raises
    `verify.tampered` (exit code 1) if a file of the bundle, the statement or its signature is not as it was
    signed, or another key has signed.
    """
    hashes = _hashes(bundle)
    if MANIFEST not in hashes:
        raise UsageProblemError("verify.no_bundle", f"{bundle} has no {MANIFEST}", "check the path")
    envelope = _read_envelope(statement or beside(bundle))
    payload, key_id = _check_signature(envelope, None if key is None else _read_key(key))
    stated = _statement(payload)
    try:
        _check_subjects(stated, hashes)
        return _verified(stated["predicate"], len(hashes), key_id, trusted=key is not None)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _tampered(f"the statement has not the form of one: {error!r}") from error


def _verified(predicate: dict[str, Any], num_files: int, key_id: str, *, trusted: bool) -> Verified:
    """Return what a statement says about the making of a bundle; raises KeyError and the like for others."""
    build, run = predicate["buildDefinition"], predicate["runDetails"]
    code, *inputs = build["resolvedDependencies"]
    revision = code.get("digest", {}).get("gitCommit", "")
    return Verified(
        num_files=num_files,
        key_id=key_id,
        trusted=trusted,
        made_by=" ".join((code["name"], code["annotations"]["version"], revision)).rstrip(),
        started_on=run["metadata"]["startedOn"],
        finished_on=run["metadata"]["finishedOn"],
        invocation=run["metadata"]["invocationId"],
        parameters=dict(build["externalParameters"]),
        inputs={each["name"]: each["digest"]["sha256"] for each in inputs},
    )


def _hashes(bundle: Path) -> dict[str, str]:
    """Return the SHA-256 of every file of a bundle, by path."""
    try:
        source = open_source(bundle)
        return {name: digest(source, name) for name in sorted(source.paths())}
    except BundleError as error:
        if error.code == "bundle.missing":
            raise UsageProblemError("verify.no_bundle", error.message, error.advice) from error
        raise _tampered(f"{bundle}: {error.message} ({error.code})") from error
    except OSError as error:
        raise UsageProblemError(
            "verify.no_bundle", f"{bundle}: {error.strerror}", "check the path"
        ) from error


def _read_envelope(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_STATEMENT_BYTES + 1)
    except OSError as error:
        raise UsageProblemError(
            "verify.no_statement",
            f"there is no statement at {path}",
            "`lambent fetch` writes it beside the bundle; name another place with --statement",
        ) from error
    if len(text) > _MAX_STATEMENT_BYTES:
        raise _tampered(f"{path} is above {_MAX_STATEMENT_BYTES} bytes")
    try:
        envelope = json.loads(text)
        return envelope if isinstance(envelope, dict) else _raise(f"{path} is not an envelope")
    except (ValueError, RecursionError) as error:
        raise _tampered(f"{path} is not JSON: {error}") from error


def _raise(message: str) -> Any:
    raise _tampered(message)


def _read_key(path: Path) -> Any:
    """Return the public key in a file."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        text = path.read_bytes()
        pem = json.loads(text)["public_key_pem"].encode() if text.lstrip().startswith(b"{") else text
        key = serialization.load_pem_public_key(pem)
    except (OSError, ValueError, KeyError, AttributeError, TypeError) as error:
        advice = "save the answer of GET /v1/provenance-key, or its PEM"
        raise UsageProblemError("verify.no_key", f"{path} has no public key", advice) from error
    if not isinstance(key, Ed25519PublicKey):
        raise UsageProblemError("verify.no_key", f"{path} has no Ed25519 key", "use that of the server")
    return key


def _check_signature(envelope: dict[str, Any], trusted: Any) -> tuple[bytes, str]:
    """Return the payload and the name of the key that has signed it.

    That is the trusted one; without one, the one in the envelope, with which anyone may have signed.
    """
    from cryptography.exceptions import InvalidSignature
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

    try:
        payload, kind = _decoded(envelope["payload"]), str(envelope["payloadType"])
        signatures = [(str(each["keyid"]), _decoded(each["sig"]), each) for each in envelope["signatures"]]
        own = [
            trusted or Ed25519PublicKey.from_public_bytes(_decoded(e["public_key"])) for *_, e in signatures
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise _tampered(f"the envelope is damaged: {error!r}") from error
    if kind != PAYLOAD_TYPE or not signatures:
        raise _tampered(f"the envelope has the type {kind!r} and {len(signatures)} signatures")
    type_bytes = kind.encode()
    signed = b"DSSEv1 %d %s %d %s" % (len(type_bytes), type_bytes, len(payload), payload)
    for (key_id, signature, _), key in zip(signatures, own, strict=True):
        try:
            key.verify(signature, signed)
        except InvalidSignature:
            continue
        if key_id == _key_id(key):
            return payload, key_id
    if trusted is None:
        raise _tampered("the statement or its signature was changed")
    others = ", ".join(key_id[:16] for key_id, *_ in signatures)
    raise _tampered(f"not signed by the key {_key_id(trusted)[:16]} but by {others}, or changed since")


def _decoded(text: str) -> bytes:
    return base64.b64decode(text, validate=True)


def _key_id(key: Any) -> str:
    from cryptography.hazmat.primitives import serialization

    raw = key.public_bytes(serialization.Encoding.Raw, serialization.PublicFormat.Raw)
    return hashlib.sha256(raw).hexdigest()


def _statement(payload: bytes) -> dict[str, Any]:
    try:
        statement = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise _tampered(f"the statement is not JSON: {error}") from error
    if not isinstance(statement, dict) or statement.get("_type") != _STATEMENT_TYPE:
        raise _tampered("the payload is not an in-toto statement")
    if statement.get("predicateType") != _PREDICATE_TYPE:
        raise _tampered(f"the statement is about {statement.get('predicateType')!r}")
    return statement


def _check_subjects(statement: dict[str, Any], hashes: dict[str, str]) -> None:
    """Raise `verify.tampered` unless the files of the bundle are exactly those of the statement."""
    stated = {each["name"]: each["digest"]["sha256"] for each in statement["subject"]}
    changed = [name for name in hashes if name in stated and stated[name] != hashes[name]]
    problems = [
        *(f"{name} was changed" for name in changed),
        *(f"{name} is missing" for name in sorted(set(stated) - set(hashes))),
        *(f"{name} was added" for name in sorted(set(hashes) - set(stated))),
    ]
    if problems:
        raise _tampered("; ".join(problems[:8]) + ("; ..." if len(problems) > 8 else ""))


def _tampered(message: str) -> TamperedError:
    return TamperedError("verify.tampered", message, "do not use it; fetch the bundle again from its server")
