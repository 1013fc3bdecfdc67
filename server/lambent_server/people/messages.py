"""Bodies of the REST interface about people, their organisations, and the audit log."""

from typing import Annotated

from pydantic import Field, JsonValue

from lambent_server.accounts.organisations import ID_PATTERN
from lambent_server.accounts.scopes import RoleName, ScopeName
from lambent_server.accounts.who import KindOfActor
from lambent_server.api.messages import Given, Shown


class Membership(Shown):
    """An organisation that a user belongs to."""

    id: str
    name: str
    role: RoleName


class Me(Shown):
    """Who makes this request."""

    kind: KindOfActor
    user_id: str | None
    """Null for keys, and for browsers that opened a one-time link."""
    name: str
    """Of the user or of the key; empty for other browsers."""
    organisation: str
    """Id of the organisation whose things this request sees."""
    organisation_name: str
    scopes: list[ScopeName]
    organisations: list[Membership]
    """Those that the user can switch to, by name; empty without a user."""


class Switch(Given):
    """The organisation to continue with."""

    organisation: Annotated[str, Field(pattern=f"^{ID_PATTERN}$")]


class AuditEntry(Shown):
    """An action, or the refusal of one."""

    id: str
    at: str
    actor_kind: KindOfActor
    actor_id: str
    """Of the key, user or link; the name of an operator's account; empty for a browser without a user."""
    action: str
    """The operation of this interface, or the command of an operator."""
    target: str
    """Id of what it was done to."""
    address: str
    request_id: str
    outcome: str
    """`done`, or the code of the problem."""
    details: dict[str, JsonValue]
    hash: str
    """Of the entry before and of this one: see `lambent admin audit verify`."""


class AuditEntryList(Shown):
    """One page of the audit log, newest first."""

    items: list[AuditEntry]
    next_cursor: str | None
