"""Errors of the REST interface: RFC 9457 problem documents with a stable code."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True, slots=True)
class Detail:
    """One error in a request; `pointer` is a JSON pointer into the body, or for example "#/query/name"."""

    pointer: str
    message: str


@dataclass
class Problem(Exception):  # noqa: N818 (it is what RFC 9457 calls it)
    """The reason why a request was refused; becomes the response."""

    status: int
    code: str
    detail: str
    retryable: bool = False
    errors: Sequence[Detail] = ()
    headers: dict[str, str] = field(default_factory=dict)
    members: dict[str, Any] = field(default_factory=dict)

    def document(self, request_id: str) -> dict[str, Any]:
        """Return the body of the response."""
        return {
            "type": "about:blank",
            "title": HTTPStatus(self.status).phrase,
            "status": self.status,
            "code": self.code,
            "detail": self.detail,
            "retryable": self.retryable,
            "errors": [{"pointer": each.pointer, "message": each.message} for each in self.errors],
            "request_id": request_id,
            **self.members,
        }


def not_found(kind: str, identifier: str) -> Problem:
    """Return the problem for an id that does not exist, or belongs to another tenant."""
    return Problem(404, f"{kind}_not_found", f"there is no {kind} {identifier!r}")


def conflict(code: str, detail: str, **members: Any) -> Problem:
    """Return the problem for a request that the current state does not allow."""
    return Problem(409, code, detail, members=members)


def invalid(code: str, pointer: str, message: str) -> Problem:
    """Return the problem for a well-formed value that cannot be used."""
    return Problem(422, code, message, errors=(Detail(pointer, message),))
