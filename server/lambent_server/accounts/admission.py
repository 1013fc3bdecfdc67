"""Admission of blobs to the store: the quota of bytes, and the entry in the audit log."""

from dataclasses import dataclass

from sqlalchemy import Connection

from lambent_server.accounts import audit, quotas
from lambent_server.accounts.who import Who
from lambent_server.core.settings import Settings
from lambent_server.storage import reservations


@dataclass(frozen=True, kw_only=True, slots=True)
class Admission:
    """Lets `who` store blobs as far as the organisation's quota goes, and records each new one."""

    who: Who
    settings: Settings
    action: str
    """Of the entries."""

    def expected(self, connection: Connection, sha256: str, size_bytes: float) -> None:
        """Refuse bytes for which there is no room, before they are written."""
        quotas.check_bytes(connection, self.who.tenant, self.settings, size_bytes, of=(sha256,))

    def added(self, connection: Connection, sha256: str) -> None:
        """Refuse them if others have used the room meanwhile; record them otherwise."""
        reservations.use(connection, self.who.tenant, sha256, self.settings)
        quotas.check_bytes(connection, self.who.tenant, self.settings)
        audit.record(connection, self.who, self.action, sha256)
