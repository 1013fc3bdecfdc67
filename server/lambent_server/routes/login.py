"""Login of browsers: a one-time link is exchanged for a cookie that scripts cannot read."""

from fastapi import APIRouter, Request, Response

from lambent_server.clock import rfc3339
from lambent_server.http.identity import COOKIE, LoginCodes, cookie_token, end_session, open_session
from lambent_server.keys import last_revoked_at
from lambent_server.messages import LoginCode, LoginLink
from lambent_server.problems import Problem
from lambent_server.routes.common import ServicesOf, TenantOf, problems

router = APIRouter(tags=["login"])


def _codes(request: Request) -> LoginCodes:
    codes: LoginCodes = request.app.state.login_codes
    return codes


@router.post("/v1/login", status_code=204, response_class=Response, responses=problems(400, 413, 422))
def log_in(services: ServicesOf, request: Request, body: LoginCode) -> Response:
    """Exchange the code of a one-time link for a session cookie."""
    tenant, made_at = _codes(request).redeem(body.code)
    with services.database.write() as connection:
        # The link may have been created with a key that has been revoked since.
        if tenant is None or made_at <= last_revoked_at(connection, tenant):
            raise Problem(
                401,
                "login_code_invalid",
                "this link has been used or is too old; `POST /v1/login-links` creates a new one",
                headers={"www-authenticate": 'Bearer realm="lambent"'},
            )
        token = open_session(connection, tenant, services.settings.session_s)
    response = Response(status_code=204)
    secure = request.url.scheme == "https"
    lifetime = int(services.settings.session_s)
    response.set_cookie(COOKIE, token, max_age=lifetime, httponly=True, samesite="strict", secure=secure)
    return response


@router.post("/v1/logout", status_code=204, response_class=Response, responses=problems(403))
def log_out(services: ServicesOf, request: Request, tenant: TenantOf) -> Response:
    """End the session of this browser, if there is one."""
    if token := cookie_token(request.headers.get("cookie", "")):
        end_session(services.database, tenant, token)
    response = Response(status_code=204)
    response.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=request.url.scheme == "https")
    return response


@router.post("/v1/login-links", status_code=201, responses=problems(403))
def create_login_link(request: Request, tenant: TenantOf) -> LoginLink:
    """Create a link that logs in one browser, once."""
    code, until = _codes(request).issue(tenant)
    return LoginLink(url=f"{str(request.base_url).rstrip('/')}/#code={code}", expires_at=rfc3339(until))
