"""The one who makes a request, as far as the server knows."""

import os
import pwd
from dataclasses import dataclass
from typing import Literal

from lambent_server.accounts.scopes import ALL, ScopeName
from lambent_server.database.tenancy import Tenant

KindOfActor = Literal["key", "session", "user", "link", "operator", "nobody"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Maker:
    """Who made a one-time link, for it ends with them."""

    user_id: str | None = None
    key_id: str | None = None


NOBODY = Maker()
"""The server itself, or an operator."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Who:
    """A key, a browser (with a user, or logged in by a one-time link), a share link, or an operator."""

    tenant: Tenant
    kind: KindOfActor
    id: str
    """Of the key, user or link; names nobody after its row is deleted. "" for a browser without a user."""
    scopes: frozenset[ScopeName]
    address: str = ""
    request_id: str = ""
    link_maker: Maker = NOBODY
    """Of a browser without a user: who made the one-time link that it opened."""

    @property
    def user_id(self) -> str | None:
        """Return the id of the user who has signed in, or None."""
        return self.id if self.kind == "user" else None

    @property
    def client(self) -> str:
        """Return the name of the one who has a client's share of what there is."""
        return f"{self.kind} {self.id}"

    @property
    def maker(self) -> Maker:
        """Return with whom the one-time links end that this one makes."""
        if self.kind == "key":
            return Maker(key_id=self.id)
        return self.link_maker if self.user_id is None else Maker(user_id=self.user_id)


def operator(tenant: Tenant) -> Who:
    """Return the one who runs a command on the server's machine, for the audit log of an organisation."""
    return Who(tenant=tenant, kind="operator", id=_account(), scopes=ALL)


def _account() -> str:
    """Return the name of the account of this process, whatever variables such as LOGNAME say."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"uid {os.getuid()}"
