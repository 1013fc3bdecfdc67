"""Scopes, which say what a key or a person may do, and the roles of people, which are sets of them."""

from collections.abc import Iterable
from typing import Literal, get_args

ScopeName = Literal["read", "submit", "render", "admin"]
RoleName = Literal["viewer", "editor", "admin"]

READ: ScopeName = "read"
"""See everything of the organisation."""
SUBMIT: ScopeName = "submit"
"""Upload scenes, queue and cancel jobs, share bundles, and delete any of these."""
RENDER: ScopeName = "render"
"""Upload environments and queue pictures."""
ADMIN: ScopeName = "admin"
"""Manage keys, login links, webhooks, and read the audit log."""

ALL: frozenset[ScopeName] = frozenset(get_args(ScopeName))
ROLES: dict[RoleName, frozenset[ScopeName]] = {
    "viewer": frozenset({READ}),
    "editor": frozenset({READ, SUBMIT, RENDER}),
    "admin": ALL,
}


def of_role(role: str) -> frozenset[ScopeName]:
    """Return what a member with this role may do; nothing for a role that is not known."""
    return next((scopes for name, scopes in ROLES.items() if name == role), frozenset())


def joined(scopes: Iterable[ScopeName]) -> str:
    """Return scopes as the database stores them."""
    return " ".join(sorted(set(scopes)))


def parsed(text: str | None) -> frozenset[ScopeName]:
    """Return stored scopes: all for null."""
    if text is None:
        return ALL
    stored = set(text.split())
    return frozenset(scope for scope in ALL if scope in stored)
