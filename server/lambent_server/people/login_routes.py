"""Login of browsers: a one-time link is exchanged for a cookie that scripts cannot read."""

import math

from fastapi import APIRouter, Request, Response
from sqlalchemy import Connection

from lambent_server.accounts import audit, organisations
from lambent_server.accounts.keys import last_revoked_at
from lambent_server.accounts.makers import scopes_of_maker
from lambent_server.accounts.scopes import ADMIN
from lambent_server.api.json_bodies import StrictRoute
from lambent_server.api.messages import LoginCode, LoginLink
from lambent_server.api.problems import Problem
from lambent_server.core.clock import now, rfc3339
from lambent_server.http.common import ServicesOf, TenantOf, WhoOf, problems
from lambent_server.http.identity import (
    Redeemed,
    cookie_token,
    end_session,
    issue_login_code,
    open_session,
    redeem_login_code,
)
from lambent_server.people.cookies import end_of_session, give_session, visitor

router = APIRouter(tags=["login"], route_class=StrictRoute)


@router.post("/v1/login", status_code=204, response_class=Response, responses=problems(400, 413, 422))
def log_in(services: ServicesOf, request: Request, body: LoginCode) -> Response:
    """Exchange the code of a one-time link for a session cookie."""
    # All in one transaction: a link whose session could not be opened can be used again.
    token, lifetime_s = None, services.settings.session_s
    with services.database.write() as connection:
        used = redeem_login_code(connection, body.code)
        if used is not None:
            is_open = organisations.is_open(connection, used.tenant)
            if is_open and _is_valid(connection, used):
                # No longer than the session in which the link was made.
                until = math.inf if used.until is None else used.until
                lifetime_s = min(services.settings.session_s, until - now())
                token = open_session(
                    connection, used.tenant, lifetime_s, maker=used.maker, within=used.session
                )
            outcome = "login_code_invalid" if token is None else audit.DONE
            who = visitor(request, used.tenant if is_open else audit.SERVER)
            audit.record(connection, who, "log_in", outcome=outcome)
    if token is None:
        raise Problem(
            401,
            "login_code_invalid",
            "this link has been used or is too old; `POST /v1/login-links` creates a new one",
            headers={"www-authenticate": 'Bearer realm="lambent"'},
        )
    response = Response(status_code=204)
    give_session(request, response, token, lifetime_s)
    return response


def _is_valid(connection: Connection, used: Redeemed) -> bool:
    """Return whether nobody has revoked a key since the link was made, and its maker has not left."""
    is_known = ADMIN in scopes_of_maker(connection, used.tenant, used.maker)
    return is_known and used.made_at > last_revoked_at(connection, used.tenant)


@router.post("/v1/logout", status_code=204, response_class=Response, responses=problems(403))
def log_out(services: ServicesOf, request: Request, tenant: TenantOf, who: WhoOf) -> Response:
    """End the session of this browser, if there is one."""
    if token := cookie_token(request.headers.get("cookie", "")):
        with audit.recorded(services.database, who, "log_out") as connection:
            end_session(connection, tenant, token)
    response = Response(status_code=204)
    end_of_session(request, response)
    return response


@router.post("/v1/login-links", status_code=201, responses=problems(403))
def create_login_link(services: ServicesOf, request: Request, tenant: TenantOf, who: WhoOf) -> LoginLink:
    """Create a link that logs in one browser, once; that browser may do what the maker of the link may.

    A link made in a browser opens a session that ends with that browser's, at its logout too.
    """
    session = None if request.state.by_key else cookie_token(request.headers.get("cookie", ""))
    with audit.recorded(services.database, who, "create_login_link") as connection:
        lifetime_s = services.settings.login_code_s
        code, until = issue_login_code(connection, tenant, lifetime_s, who.maker, session)
    return LoginLink(url=f"{str(request.base_url).rstrip('/')}/#code={code}", expires_at=rfc3339(until))
