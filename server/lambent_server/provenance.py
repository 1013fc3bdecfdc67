"""Signed statements of where a bundle is from: its inputs, the code, the settings, the machine and the times.

A statement is an in-toto Statement with a SLSA provenance predicate, in a DSSE envelope that is signed with
the server's Ed25519 key. Its subjects are the manifest and every file of the bundle.
"""

import base64
import hashlib
import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sqlalchemy import Connection

from lambent_server.cluster.shared_secrets import shared_secret
from lambent_server.core.clock import now, rfc3339
from lambent_server.core.secrets import read_or_create
from lambent_server.core.settings import ServeError, Settings
from lambent_server.database.engine import Database
from lambent_server.database.model import JobRow
from lambent_server.database.people_schema import provenance_statements
from lambent_server.database.tenancy import Tenant, add, remove, rows

FILE = "provenance.key"
PAYLOAD_TYPE = "application/vnd.in-toto+json"
STATEMENT_TYPE = "https://in-toto.io/Statement/v1"
PREDICATE_TYPE = "https://slsa.dev/provenance/v1"
BUILD_TYPE = "urn:lambent:job:1"


class Signer:
    """The key with which servers sign."""

    def __init__(self, pem: str, where: str = FILE) -> None:
        """Take the private key in `pem`; raises ServeError, which says `where` it is, for any other text."""
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

        encoding, raw = serialization.Encoding.PEM, serialization.Encoding.Raw
        try:
            key = serialization.load_pem_private_key(pem.encode(), None)
        except ValueError as error:
            raise ServeError(f"serve.secret_invalid: {where} contains no private key in PEM") from error
        if not isinstance(key, Ed25519PrivateKey):
            raise ServeError(f"serve.secret_invalid: {where} contains no Ed25519 key")
        self._key = key
        public = key.public_key()
        self.public_pem = public.public_bytes(
            encoding, serialization.PublicFormat.SubjectPublicKeyInfo
        ).decode()
        raw_key = public.public_bytes(raw, serialization.PublicFormat.Raw)
        self.key_id = key_id_of(raw_key)
        self._raw_key = raw_key

    def envelope(self, statement: Mapping[str, Any]) -> str:
        """Return a statement in a signed envelope, as JSON."""
        payload = json.dumps(statement, sort_keys=True, separators=(",", ":")).encode()
        signature = self._key.sign(pre_authentication(PAYLOAD_TYPE, payload))
        return json.dumps(
            {
                "payloadType": PAYLOAD_TYPE,
                "payload": base64.b64encode(payload).decode(),
                "signatures": [
                    {
                        "keyid": self.key_id,
                        "sig": base64.b64encode(signature).decode(),
                        # So that damage is noticed without the key; whom to trust, nothing in here can say.
                        "public_key": base64.b64encode(self._raw_key).decode(),
                    }
                ],
            }
        )


def new_key() -> str:
    """Return a new private key as PEM."""
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

    pem = Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return pem.decode().strip()


def open_signer(database: Database, settings: Settings) -> Signer:
    """Return the signer of all servers on a database; the first one makes its key.

    The key is where other secrets are: in the database, or in a file if there is one server, or a folder of
    secrets. Raises ServeError for a file without a key.
    """
    if settings.provenance_key is not None:
        return Signer(read_or_create(settings.provenance_key, new_key), str(settings.provenance_key))
    in_file = database.is_sqlite or settings.secrets is not None
    place = str((settings.secrets or settings.data) / FILE) if in_file else "the database"
    return Signer(shared_secret(database, settings, FILE, new_key), place)


def key_id_of(public_key: bytes) -> str:
    """Return the name of a key: the SHA-256 of its 32 bytes."""
    return hashlib.sha256(public_key).hexdigest()


def pre_authentication(payload_type: str, payload: bytes) -> bytes:
    """Return what a signature covers (DSSE, PAE)."""
    kind = payload_type.encode()
    return b"DSSEv1 %d %s %d %s" % (len(kind), kind, len(payload), payload)


def statement_of(
    job: JobRow,
    *,
    bundle_id: str,
    files: Mapping[str, str],
    inputs: Iterable[tuple[str, str]],
    generator: Mapping[str, str],
    key_id: str,
) -> dict[str, Any]:
    """Return the statement of a bundle.

    `files` and `inputs` are paths with their SHA-256; `generator` is the program that the manifest names:
    its name, version and revision.
    """
    external = {
        name: getattr(job, name)
        for name in ("kind", "preset", "params", "seed", "gpus", "scene_id", "labels")
    }
    code = {"name": generator["name"] or "lambent", "annotations": {"version": generator["version"]}}
    if generator["git_revision"]:
        code["digest"] = {"gitCommit": generator["git_revision"]}
    return {
        "_type": STATEMENT_TYPE,
        "subject": [_resource(path, sha256) for path, sha256 in sorted(files.items())],
        "predicateType": PREDICATE_TYPE,
        "predicate": {
            "buildDefinition": {
                "buildType": BUILD_TYPE,
                "externalParameters": external,
                "internalParameters": {"adjustments": job.adjustments, "machine": machine(job)},
                "resolvedDependencies": [code, *(_resource(path, sha256) for path, sha256 in sorted(inputs))],
            },
            "runDetails": {
                "builder": {"id": f"urn:lambent:server:{key_id}", "version": {"lambent": version("lambent")}},
                "metadata": {
                    "invocationId": f"{job.id}/{job.run}",
                    "startedOn": rfc3339(job.started_at or job.created_at),
                    "finishedOn": rfc3339(now()),
                },
                "byproducts": [{"name": "bundle", "annotations": {"id": bundle_id}}],
            },
        },
    }


def _resource(path: str, sha256: str) -> dict[str, Any]:
    return {"name": path, "digest": {"sha256": sha256}}


def machine(job: JobRow) -> dict[str, Any]:
    """Return what kind of machine this is, where local runs are too, and the GPUs that a run has had."""
    used = (job.handle or {}).get("gpus", [])
    return {
        "system": platform.system(),
        "architecture": platform.machine(),
        "python": platform.python_version(),
        "cores": os.cpu_count() or 0,
        "gpus": job.gpus,
        "gpu_models": _gpu_models(used),
    }


def _gpu_models(used: Sequence[int]) -> list[str]:
    """Return the models of the GPUs of a run, as NVIDIA's driver names them; none where it says nothing."""
    devices = sorted(Path("/proc/driver/nvidia/gpus").glob("*/information"))
    models = []
    for number in used:
        if number < len(devices):
            lines = devices[number].read_text(encoding="utf-8", errors="replace").splitlines()
            models += [line.partition(":")[2].strip() for line in lines if line.startswith("Model:")]
    return models


def store(connection: Connection, tenant: Tenant, bundle_id: str, envelope: str) -> None:
    """Store the envelope of a bundle."""
    values = {"bundle_id": bundle_id, "envelope": envelope, "created_at": now()}
    connection.execute(add(tenant, provenance_statements, **values))


def find(connection: Connection, tenant: Tenant, bundle_id: str) -> str | None:
    """Return the envelope of a bundle as JSON; None if it has none."""
    mine = provenance_statements.c.bundle_id == bundle_id
    statement = rows(tenant, provenance_statements, provenance_statements.c.envelope).where(mine)
    return connection.execute(statement).scalar_one_or_none()


def forget(connection: Connection, tenant: Tenant, bundle_id: str) -> None:
    """Delete the envelope of a bundle that is deleted."""
    mine = provenance_statements.c.bundle_id == bundle_id
    connection.execute(remove(tenant, provenance_statements).where(mine))
