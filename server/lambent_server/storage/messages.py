"""Messages of uploads that go directly to the store."""

from typing import Annotated

from pydantic import Field

from lambent_server.api.messages import Given, Sha256, Shown, SizeBytes


class UploadPart(Shown):
    """A range of a file, and the address to PUT it to, which needs no other authentication."""

    number: int
    """From 1; 0 for a whole file."""
    offset: SizeBytes
    size_bytes: SizeBytes
    url: str
    headers: dict[str, str]
    """Headers that must be sent with it."""


class FileUpload(Shown):
    """What is still to be sent of a file; report its completion afterwards."""

    sha256: Sha256
    size_bytes: SizeBytes
    parts: list[UploadPart]
    """Empty if everything was sent already."""
    expires_at: str
    """When the addresses stop working; ask for new ones then."""


class UploadedFiles(Given):
    """Hashes of planned files."""

    sha256: Annotated[list[Sha256], Field(min_length=1, max_length=100)]


class UploadList(Shown):
    """Where to send files."""

    items: list[FileUpload]
    """One for each file that can be sent directly; PUT the others to the server."""


class RefusedFile(Shown):
    """A file that was not taken over."""

    sha256: Sha256
    code: str
    """`upload_missing`: send what is missing; `digest_mismatch`: its bytes are not those of the hash."""
    detail: str


class TakenFiles(Shown):
    """Which files the server has taken over."""

    stored: list[Sha256]
    refused: list[RefusedFile]


class Plan(Shown):
    """The files still to be uploaded, and those that will not be part of the scene."""

    missing: list[Sha256]
    unsupported: list[str]
    uploads: list[FileUpload]
    """Where to send the first of them directly; empty if this server takes the files itself."""
