"""Parameters and responses that the routes share."""

from typing import Annotated, Any

from fastapi import Depends, Path, Request
from starlette.convertors import StringConvertor, register_url_convertor

from lambent_server.accounts.who import Who
from lambent_server.api.messages import ProblemDocument
from lambent_server.api.problems import MEDIA_TYPE, Problem
from lambent_server.database.tenancy import Tenant
from lambent_server.services import Services


class _Identifier(StringConvertor):
    """A path segment without a colon, so that `/jobs/x:cancel` is never the job "x:cancel"."""

    regex = "[^/:]+"


register_url_convertor("id", _Identifier())


# Coroutines, because FastAPI would run functions in a thread, twice for every request.
async def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


async def _tenant(request: Request) -> Tenant:
    tenant: Tenant = request.state.tenant
    return tenant


def require_key(request: Request, what: str) -> None:
    """Refuse a browser session: taking one over briefly must not yield something lasting."""
    if not request.state.by_key:
        raise Problem(403, "key_needed", f"{what} requires a key; a browser session is not enough")


async def _who(request: Request) -> Who:
    who: Who = request.state.who
    return who


ServicesOf = Annotated[Services, Depends(_services)]
TenantOf = Annotated[Tenant, Depends(_tenant)]
WhoOf = Annotated[Who, Depends(_who)]
Id = Annotated[str, Path(min_length=1, max_length=64)]
Sha = Annotated[str, Path(pattern="^[0-9a-f]{64}$")]


def problems(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI entries of the problems that an operation may return."""
    content = {MEDIA_TYPE: {"schema": {"$ref": f"#/components/schemas/{ProblemDocument.__name__}"}}}
    texts = {
        400: "The body is not valid JSON.",
        401: "No valid key or session.",
        403: "The key or session lacks the scope, or the write may come from another site.",
        404: "It does not exist, or belongs to another tenant.",
        408: "The body was sent too slowly.",
        409: "The current state does not allow it.",
        410: "Its bytes were lost.",
        412: "It has changed since the client read it.",
        413: "The body is too large.",
        416: "The range lies outside of the file.",
        421: "The server does not serve this host name.",
        422: "Values cannot be used; `errors` points to each.",
        429: "A quota is used up, or the client writes too fast.",
        503: "The database does not answer, or the server is shutting down.",
        507: "The disk is nearly full, or the quota of bytes is used up.",
    }
    always = (401, 403, 421, 429, 503)
    return {each: {"description": texts[each], "content": content} for each in sorted({*statuses, *always})}


def binary_body(*media_types: str) -> dict[str, Any]:
    """Return the OpenAPI entry of a binary body."""
    schema = {"type": "string", "format": "binary"}
    return {"requestBody": {"required": True, "content": {each: {"schema": schema} for each in media_types}}}
