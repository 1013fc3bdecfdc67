"""Entity tags of JSON, conditional requests, and idempotency keys, for all operations."""

import hashlib
import json
from collections.abc import Callable, Coroutine
from typing import Annotated, Any

from fastapi import Header, Request, Response
from lambent_pages import is_named
from pydantic import BaseModel
from sqlalchemy import Connection

from lambent_server.api.json_bodies import StrictRoute
from lambent_server.api.problems import Problem, invalid, not_found
from lambent_server.database.rows import Kind
from lambent_server.database.tenancy import Tenant, find

_JSON = "application/json"
_TAG_DIGITS = 32
_MAX_TAGS = 2000
"""Characters of a list of ETags."""

IdempotencyKey = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        pattern=r"^[\x21-\x7e]{1,200}$",
        description="The same key with the same request gives the same result for a week.",
    ),
]
IfMatch = Annotated[
    str | None,
    Header(
        alias="If-Match",
        max_length=_MAX_TAGS,
        description="Change it only if it has this ETag; 412 otherwise.",
    ),
]


class ResourceRoute(StrictRoute):
    """A route whose answers in JSON have an ETag; a GET that brings the current one is answered with 304."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of a request."""
        handle = super().get_route_handler()
        if not self.path.startswith("/v1/") or not {"GET", "PATCH"} & set(self.methods or ()):
            return handle

        async def tagged(request: Request) -> Response:
            if len(request.headers.get("if-none-match", "")) > _MAX_TAGS:
                message = f"at most {_MAX_TAGS} characters"
                raise invalid("invalid_request", "#/header/If-None-Match", message)
            return _tagged(request, await handle(request))

        return tagged


def _tagged(request: Request, response: Response) -> Response:
    if response.status_code != 200 or response.headers.get("content-type") != _JSON:
        return response
    tag = _tag(json.loads(bytes(response.body)))
    headers = {"etag": tag, "cache-control": "private, no-cache"}
    if request.method == "GET" and is_named(tag, request.headers.get("if-none-match")):
        vary = response.headers.get("vary")
        return Response(status_code=304, headers=headers | ({"vary": vary} if vary else {}))
    response.headers.update(headers)
    return response


def _tag(content: Any) -> str:
    """Return the tag of a JSON value, the same however it is written."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return f'"{hashlib.sha256(text.encode()).hexdigest()[:_TAG_DIGITS]}"'


def require(
    connection: Connection,
    tenant: Tenant,
    kind: type[Kind],
    name: str,
    identifier: str,
    *,
    lock: bool = False,
) -> Kind:
    """Return the row of a resource; raises `<name>_not_found`. With `lock`, nobody else can change it."""
    row = find(connection, tenant, kind, identifier, lock=lock)
    if row is None:
        raise not_found(name, identifier)
    return row


def require_match(if_match: str | None, shown: BaseModel) -> None:
    """Refuse to change what has changed since the client read it; `shown` is what a GET returns now."""
    if if_match is None:
        return
    # An empty header names no state, so it matches none; nor do weak tags ever (RFC 9110, 13.1.1).
    tags = {each.strip() for each in if_match.split(",")}
    if tags != {"*"} and _tag(shown.model_dump(mode="json")) not in tags:
        raise Problem(
            412, "precondition_failed", "this has changed since you read it; read it again, then decide"
        )


def digest_of(operation: str, *parts: BaseModel | str) -> str:
    """Return the hash by which a repeated request is known."""
    texts = (part if isinstance(part, str) else part.model_dump_json() for part in parts)
    return hashlib.sha256("\n".join((operation, *texts)).encode()).hexdigest()


def describe_conditions(operation: dict[str, Any]) -> None:
    """Add to the description of a GET that its answers have an ETag and that it can be conditional."""
    answer = operation["responses"].get("200", {})
    if _JSON not in answer.get("content", {}):
        return
    operation.setdefault("parameters", []).append(
        {
            "name": "If-None-Match",
            "in": "header",
            "required": False,
            "schema": {"type": "string", "maxLength": _MAX_TAGS},
            "description": "ETags that the client has; 304 if the current one is among them.",
        }
    )
    answer.setdefault("headers", {})["ETag"] = {"schema": {"type": "string"}}
    operation["responses"]["304"] = {"description": "The client's copy is current."}
