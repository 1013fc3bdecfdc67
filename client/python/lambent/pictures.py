"""Pictures that a server makes: environment maps, orders, files."""

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any
from uuid import uuid4

from lambent_core.files import file_sha256

from lambent.connection import Connection
from lambent.errors import RefusedError, UsageProblemError
from lambent.models import Artifact, Environment

_BETWEEN_JOBS = frozenset({"pictures.jsonl", "tiles.zip"})
_SHEET = re.compile(r"contact_sheet(_\d+)?\.png")


def for_people(artifacts: Iterable[Artifact]) -> list[Artifact]:
    """Return the files of a batch without those that its jobs leave for each other."""
    return [artifact for artifact in artifacts if artifact.name not in _BETWEEN_JOBS]


def contact_sheets(artifacts: Iterable[Artifact]) -> list[Artifact]:
    """Return the contact sheets among the files of a batch."""
    return [artifact for artifact in artifacts if _SHEET.fullmatch(artifact.name)]


def post(connection: Connection, path: str, body: Mapping[str, Any], idempotency_key: str) -> Any:
    """Return the answer to an order; it may be repeated after a lost answer, so it always has a key."""
    headers = {"Idempotency-Key": idempotency_key or f"order-{uuid4().hex}"}
    return connection.json("POST", path, json=dict(body), headers=headers)


def _is_damaged(connection: Connection, sha256: str) -> bool:
    """Return whether the server has lost the bytes of a file that it knows."""
    try:
        connection.send("GET", f"/v1/blobs/{sha256}", headers={"Range": "bytes=0-0"})
    except RefusedError as error:
        if error.code != "blob_damaged":
            raise
        return True
    return False


def push_environment(connection: Connection, source: Path, *, name: str = "") -> Environment:
    """Return the environment of a file, uploaded unless the server has these bytes under that name.

    Bytes that were damaged in the server's store are sent again, which repairs whatever uses them.
    Raises `environment.missing` where there is no such file.
    """
    if not source.is_file():
        raise UsageProblemError("environment.missing", f"there is no file {source}", "check the path")
    name = name or source.name
    digest = file_sha256(source)
    for item in connection.json("GET", "/v1/environments")["items"]:
        if (item["sha256"], item["name"]) == (digest, name) and not _is_damaged(connection, digest):
            return Environment.from_json(item)

    answer = connection.upload("POST", "/v1/environments", source, params={"name": name})
    return Environment.from_json(answer)
