"""The person behind a request, the organisations that a user can switch to, and the audit log."""

import json
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import AwareDatetime, Field
from sqlalchemy import Connection

from lambent_server.accounts import audit, organisations, users
from lambent_server.accounts.scopes import of_role
from lambent_server.accounts.who import Who
from lambent_server.api.pagination import LongPageFilter, select_newest
from lambent_server.api.problems import Problem, not_found
from lambent_server.api.resources import ResourceRoute
from lambent_server.core.clock import now
from lambent_server.database.model import AuditRow, KeyRow
from lambent_server.database.people_schema import audit_entries
from lambent_server.database.tenancy import Tenant, find
from lambent_server.http.common import ServicesOf, TenantOf, WhoOf, problems
from lambent_server.http.identity import cookie_token, end_session, open_session
from lambent_server.people.cookies import give_session
from lambent_server.people.messages import AuditEntry, AuditEntryList, Me, Membership, Switch

router = APIRouter(tags=["people"], route_class=ResourceRoute)

# Commands have spaces, targets may be paths: only what no entry can have is refused.
Word = Annotated[str | None, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]


class AuditFilter(LongPageFilter):
    """The entries to list."""

    action: Word = None
    actor: Word = None
    target: Word = None
    outcome: Word = None
    since: Annotated[AwareDatetime | None, Field(description="Only from this time on (RFC 3339).")] = None
    until: Annotated[AwareDatetime | None, Field(description="Only from before this time.")] = None


@router.get("/v1/me", responses=problems())
def get_me(services: ServicesOf, who: WhoOf) -> Me:
    """Return who makes this request, and what they may do."""
    with services.database.read() as connection:
        return _show_me(connection, who)


def _show_me(connection: Connection, who: Who) -> Me:
    organisation = organisations.find(connection, who.tenant)
    user = None if who.user_id is None else users.find(connection, who.user_id)
    key = find(connection, who.tenant, KeyRow, who.id) if who.kind == "key" else None
    own = [] if who.user_id is None else users.memberships(connection, who.user_id)
    return Me(
        kind=who.kind,
        user_id=who.user_id,
        name=user.name if user else key.name if key else "",
        organisation=who.tenant.id,
        organisation_name=who.tenant.id if organisation is None else organisation.name,
        scopes=sorted(who.scopes),
        organisations=[Membership(id=row.tenant_id, name=row.name, role=row.role) for row in own],
    )


@router.post("/v1/me:switch", responses=problems(400, 403, 404, 409, 413, 422))
def switch_organisation(
    services: ServicesOf, who: WhoOf, request: Request, response: Response, body: Switch
) -> Me:
    """Continue with another organisation in this browser; it gets a new cookie."""
    if who.user_id is None:
        raise Problem(409, "no_user", "only a browser in which a user has signed in can switch")
    target = Tenant(body.organisation)
    with services.database.write() as connection:
        known = [row for row in users.memberships(connection, who.user_id) if row.tenant_id == target.id]
        if not known:
            raise not_found("organisation", body.organisation)
        token = cookie_token(request.headers.get("cookie", "")) or ""
        until = end_session(connection, who.tenant, token)
        if until is None:
            raise Problem(401, "not_authenticated", "this session has just ended; sign in again")
        # As long as the sign-in is valid, and no longer for having switched.
        left_s = until - now()
        fresh = open_session(connection, target, left_s, who.user_id)
        there = Who(
            tenant=target,
            kind="user",
            id=who.id,
            scopes=of_role(known[0].role),
            address=who.address,
            request_id=who.request_id,
        )
        shown = _show_me(connection, there)
        audit.record(connection, there, "switch_organisation", target.id)
    give_session(request, response, fresh, left_s)
    return shown


@router.get("/v1/audit", responses=problems(403, 422))
def list_audit_entries(
    services: ServicesOf, tenant: TenantOf, given: Annotated[AuditFilter, Query()]
) -> AuditEntryList:
    """List what was done in this organisation, newest first."""
    columns = {"action": given.action, "actor_id": given.actor, "target": given.target}
    columns["outcome"] = given.outcome
    conditions = [audit_entries.c[name] == value for name, value in columns.items() if value is not None]
    if given.since is not None:
        conditions.append(audit_entries.c.at >= given.since.timestamp())
    if given.until is not None:
        conditions.append(audit_entries.c.at < given.until.timestamp())
    with services.database.read() as connection:
        page, cursor = select_newest(connection, tenant, AuditRow, *conditions, page=given)
    return AuditEntryList(items=[show_entry(row) for row in page], next_cursor=cursor)


def show_entry(row: AuditRow) -> AuditEntry:
    """Return an entry of the audit log in the form of the REST interface."""
    return AuditEntry.of(row, details=json.loads(row.details))
