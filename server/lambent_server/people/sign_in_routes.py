"""Sign-in of people: at an OpenID Connect provider, or by the header of a trusted proxy."""

import hmac
import re
import secrets
from collections.abc import Callable
from functools import partial
from typing import Annotated, Any
from urllib.parse import urlencode

import structlog
from anyio import CapacityLimiter, to_thread
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import RedirectResponse
from pydantic import Field
from sqlalchemy import Connection, delete, insert

from lambent_server.accounts import audit
from lambent_server.accounts.oidc import Provider, SignInError
from lambent_server.accounts.sign_in import RefusedError, Vouched, admit, of_claims, of_proxy
from lambent_server.api.json_bodies import StrictRoute
from lambent_server.api.outside_text import storable
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now
from lambent_server.core.secrets import sha256_text
from lambent_server.core.settings import Settings
from lambent_server.database.people_schema import sign_ins
from lambent_server.http.common import ServicesOf, problems
from lambent_server.http.identity import cookie_token, open_session
from lambent_server.http.login_header import LOGIN_NAME, LOGIN_ORGANISATIONS
from lambent_server.people.cookies import give_session, visitor
from lambent_server.services import Services

log = structlog.get_logger()

router = APIRouter(tags=["login"], route_class=StrictRoute)

COOKIE = "lambent_sign_in"
PATH = "/v1/sign-in"
VALID_S = 600.0
"""Time within which a person must have signed in at the provider."""
_HERE = re.compile(r"/(?![/\\])[\x21-\x5b\x5d-\x7e]{0,500}")
REFUSED = "sign_in_refused"
FAILED = "sign_in_failed"

_REDIRECT: dict[int | str, dict[str, Any]] = {
    **problems(404, 422),
    303: {"description": "Where the browser continues."},
}
Text = Annotated[str, Field(max_length=4000)]


def sign_in_url(settings: Settings) -> str | None:
    """Return where people sign in; None if that is not set up."""
    return PATH if settings.oidc_issuer is not None or settings.login_header is not None else None


def _provider(request: Request) -> Provider | None:
    provider: Provider | None = request.app.state.provider
    return provider


async def _apart(request: Request, answer: Callable[[], Response]) -> Response:
    """Return what `answer` does, in threads of sign-ins: with a provider that hangs they are all taken."""
    limiter: CapacityLimiter = request.app.state.sign_ins
    return await to_thread.run_sync(answer, limiter=limiter)


@router.get(PATH, status_code=303, response_class=Response, responses=_REDIRECT)
async def begin_sign_in(
    services: ServicesOf, request: Request, return_to: Annotated[Text, Query()] = "/"
) -> Response:
    """Sign in: at once if a trusted proxy names a user, else at the provider, and come back."""
    return await _apart(request, partial(_begin, services, request, return_to))


def _begin(services: Services, request: Request, return_to: str) -> Response:
    target = return_to if _HERE.fullmatch(return_to) else "/"
    name = getattr(request.state, LOGIN_NAME, None)
    if services.settings.login_header is not None and name is not None:
        groups = getattr(request.state, LOGIN_ORGANISATIONS, None)
        return _let_in(services, request, of_proxy(name, groups, services.settings), target)
    provider = _provider(request)
    if provider is None:
        raise Problem(404, "sign_in_not_found", "no provider is set up, and no trusted proxy names a user")
    state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(3))
    try:
        address = provider.address(_callback(request), state, nonce, verifier)
    except SignInError as error:
        return _failed(request, error)
    values = {"nonce": nonce, "verifier": verifier, "return_to": target, "created_at": now()}
    with services.database.write() as connection:
        connection.execute(delete(sign_ins).where(sign_ins.c.created_at < now() - VALID_S))
        connection.execute(insert(sign_ins).values(state_sha256=sha256_text(state), **values))
    response = RedirectResponse(address, 303)
    # Lax: the provider sends the browser back, and only the one that began may continue.
    secure = request.url.scheme == "https"
    response.set_cookie(
        COOKIE, state, max_age=int(VALID_S), path=PATH, httponly=True, samesite="lax", secure=secure
    )
    return response


def _callback(request: Request) -> str:
    return f"{str(request.base_url).rstrip('/')}{PATH}/callback"


@router.get(f"{PATH}/callback", status_code=303, response_class=Response, responses=_REDIRECT)
async def end_sign_in(
    services: ServicesOf,
    request: Request,
    state: Annotated[Text, Query()] = "",
    code: Annotated[Text, Query()] = "",
    iss: Annotated[Text | None, Query()] = None,
    error: Annotated[Text, Query()] = "",
) -> Response:
    """Come back from the provider: the browser gets the cookie of a session."""
    return await _apart(request, partial(_end, services, request, state, code, iss, error))


def _end(
    services: Services, request: Request, state: str, code: str, iss: str | None, error: str
) -> Response:
    provider = _provider(request)
    if provider is None:
        raise Problem(404, "sign_in_not_found", "no provider is set up")
    begun = _take(services, request, state)
    try:
        if begun is None:
            raise SignInError("state_invalid", "this browser has not begun this sign-in, or ten minutes ago")
        provider.check_issuer(iss)
        if error or not code:
            raise SignInError("provider_refused", f"the provider says {error[:100]!r}")
        tokens = provider.exchange(code, begun.verifier, _callback(request))
        vouched = of_claims(provider.claims(tokens, begun.nonce), services.settings)
        if not all(map(storable, (vouched.issuer, vouched.subject, vouched.email or ""))):
            raise SignInError("claims_invalid", "the claims sub or email hold what is not text")
    except SignInError as failure:
        return _failed(request, failure)
    return _let_in(services, request, vouched, begun.return_to)


def _take(services: Services, request: Request, state: str) -> Any:
    """Return what was kept of a sign-in that this browser has begun, once; None for any other."""
    kept = cookie_token(request.headers.get("cookie", ""), COOKIE)
    if not state or kept is None or not hmac.compare_digest(kept.encode(), state.encode()):
        return None
    mine = (sign_ins.c.state_sha256 == sha256_text(state)) & (sign_ins.c.created_at >= now() - VALID_S)
    with services.database.write() as connection:
        statement = delete(sign_ins).where(mine).returning(sign_ins)
        return connection.execute(statement).one_or_none()


def _failed(request: Request, error: SignInError) -> Response:
    log.warning("sign_in_failed", request=request.state.request_id, code=error.code, reason=str(error))
    return _go_on(f"/#{urlencode({'sign-in': FAILED})}")


def _go_on(target: str) -> Response:
    response = RedirectResponse(target, 303, headers={"cache-control": "no-store"})
    response.delete_cookie(COOKIE, path=PATH, httponly=True, samesite="lax")
    return response


def _let_in(services: Services, request: Request, vouched: Vouched, target: str) -> Response:
    """Return the answer to a person whom the provider or proxy vouches for."""
    lifetime_s = services.settings.session_s
    try:
        with services.database.write() as connection:
            token = _open(connection, request, vouched, services.settings)
        if token is None:
            raise RefusedError(f"{vouched.subject!r} belongs to no organisation")
    except RefusedError as refused:
        log.warning("sign_in_refused", request=request.state.request_id, reason=str(refused))
        with services.database.write() as connection:
            nobody = visitor(request, audit.SERVER, "nobody")
            details = {"issuer": vouched.issuer, "subject_sha256": sha256_text(vouched.subject)}
            audit.record(connection, nobody, "sign_in", outcome=REFUSED, details=details)
        return _go_on(f"/#{urlencode({'sign-in': REFUSED})}")
    response = _go_on(target)
    give_session(request, response, token, lifetime_s)
    return response


def _open(connection: Connection, request: Request, vouched: Vouched, settings: Settings) -> str | None:
    user_id, tenant = admit(connection, vouched, settings)
    if tenant is None:
        return None
    token = open_session(connection, tenant, settings.session_s, user_id)
    audit.record(connection, visitor(request, tenant, "user", user_id), "sign_in")
    return token
