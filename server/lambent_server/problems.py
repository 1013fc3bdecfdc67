"""Errors as the interface tells them: RFC 9457 problem documents with a stable code."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Any

MEDIA_TYPE = "application/problem+json"


@dataclass(frozen=True, slots=True)
class Detail:
    """One thing that is wrong; `pointer` is a JSON pointer into the body, or "#/query/name" and the like."""

    pointer: str
    message: str


@dataclass
class Problem(Exception):  # noqa: N818 (it is what RFC 9457 calls it)
    """Why a request was not done; becomes the answer."""

    status: int
    code: str
    detail: str
    retryable: bool = False
    errors: Sequence[Detail] = ()
    headers: dict[str, str] = field(default_factory=dict)
    members: dict[str, Any] = field(default_factory=dict)

    def document(self, request_id: str) -> dict[str, Any]:
        """Return the body of the answer."""
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
    """Return the answer to an id that does not exist, or belongs to somebody else."""
    return Problem(404, f"{kind}_not_found", f"there is no {kind} {identifier!r}")


def conflict(code: str, detail: str, **members: Any) -> Problem:
    """Return the answer to a request that the present state does not allow."""
    return Problem(409, code, detail, members=members)


def invalid(code: str, pointer: str, message: str) -> Problem:
    """Return the answer to a well-formed value that cannot be used."""
    return Problem(422, code, message, errors=(Detail(pointer, message),))
