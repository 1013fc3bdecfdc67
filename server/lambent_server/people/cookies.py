"""The cookie of a browser session, and people who are not known before they have one."""

from fastapi import Request, Response

from lambent_server.accounts.who import KindOfActor, Who
from lambent_server.database.tenancy import Tenant
from lambent_server.http.identity import COOKIE


def visitor(request: Request, tenant: Tenant, kind: KindOfActor = "session", identifier: str = "") -> Who:
    """Return a visitor who is about to get a cookie, for the audit log of a tenant."""
    return Who(
        tenant=tenant,
        kind=kind,
        id=identifier,
        scopes=frozenset(),
        address=request.client.host if request.client is not None else "",
        request_id=request.state.request_id,
    )


def give_session(request: Request, response: Response, token: str, lifetime_s: float) -> None:
    """Give a browser the cookie of a session, which scripts cannot read."""
    response.set_cookie(
        COOKIE,
        token,
        max_age=int(lifetime_s),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


def end_of_session(request: Request, response: Response) -> None:
    """Take that cookie back."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=request.url.scheme == "https")
