"""The servers on one database: each says that it lives, and knows the others.

Times are those of the database's clock, because those of machines differ. Each server has its own run
processes; what only one server must do is done by the leader.
"""

import socket
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import structlog
from sqlalchemy import Connection, delete, func, insert, select, update
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.cluster.shared_secrets import SERVER
from lambent_server.core.clock import follow, new_id
from lambent_server.core.secrets import read_or_create
from lambent_server.core.settings import Settings
from lambent_server.database.cluster_schema import leadership, servers
from lambent_server.database.columns import clock_time
from lambent_server.database.engine import Database
from lambent_server.database.leadership import Leadership
from lambent_server.database.model import ServerRow
from lambent_server.database.rows import many
from lambent_server.executors.chosen import is_on_this_machine

log = structlog.get_logger()

PROTOCOL = 1
"""Counts the changes of what servers expect of each other."""
# With SQLite nobody else is there: its row is for `lambent admin`.
_ALONE_BEAT_S = 60.0
_KEPT_S = 24 * 3600.0
"""How long servers that died are known."""
_CLOSED_S = 5.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Member(ServerRow):
    """A server among the others."""

    is_alive: bool
    leads: bool = False


def server_id(data: Path) -> str:
    """Return the name of the server with this data folder, the same after every start."""
    return read_or_create(data / SERVER, lambda: new_id("server"))


def members(connection: Connection) -> list[Member]:
    """Return the servers on this database, also those that died lately, in the order of their names."""
    leads = select(leadership.c.holder).where(leadership.c.expires_at >= clock_time(connection))
    holder = connection.execute(leads).scalar_one_or_none()
    is_alive = (servers.c.expires_at >= clock_time(connection)).label("is_alive")
    known = many(connection, select(servers, is_alive).order_by(servers.c.id), Member)
    alone = connection.dialect.name == "sqlite"
    return [replace(each, leads=each.is_alive if alone else each.id == holder) for each in known]


def most_gpus(connection: Connection, own: int) -> int:
    """Return the largest number of GPUs that a live server has; this one has `own`."""
    if connection.dialect.name == "sqlite":
        return own
    alive = select(servers.c.gpus).where(servers.c.expires_at >= clock_time(connection))
    return max([own, *map(int, connection.execute(alive).scalars())])


def total_slots(connection: Connection, own: int) -> int:
    """Return how many jobs run at the same time on all live servers; this one has `own` slots."""
    if connection.dialect.name == "sqlite":
        return max(own, 1)
    alive = select(func.sum(servers.c.slots)).where(servers.c.expires_at >= clock_time(connection))
    return max(own, int(connection.execute(alive).scalar_one() or 0), 1)


class Membership:
    """This server among the others."""

    def __init__(
        self,
        database: Database,
        settings: Settings,
        *,
        host: str,
        endpoints: tuple[str, ...] = (),
        gpus: Callable[[], int] = lambda: 0,
    ) -> None:
        """Prepare; run processes reach this server at `endpoints`, on other hosts only over the network."""
        self.id = server_id(settings.data)
        self.host = host
        """Where run processes of this server can be seen."""
        self.url = ""
        self._database = database
        self._settings = settings
        self.own_endpoints = endpoints
        self._gpus = gpus
        # Read from files, which takes longer than the rest of a beat.
        self._version = version("lambent")
        self.is_fit: Callable[[], bool] = lambda: True
        """Whether this server can do the work of a leader, if it is to be one."""
        lost_after_s = settings.server_lost_after_s
        self._leadership = Leadership(database, self.id, lost_after_s)
        self._controls_until = 0.0
        self._known = False
        self._others: tuple[Member, ...] = ()
        self._looked_at = float("-inf")
        self._beats: dict[str, tuple[float, float]] = {}
        """When each server said last that it lives, and since when this is known (monotonic)."""
        self._spared: frozenset[str] = frozenset()
        """Servers that lived before the database was unavailable, and may not have said so again yet."""
        self._spared_until = 0.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="membership", daemon=True)

    @property
    def leads(self) -> bool:
        """Whether this server does what only one must do."""
        return self._leadership.is_held

    @property
    def controls(self) -> bool:
        """Whether this server may start jobs, and end those that it started."""
        return self._database.is_sqlite or time.monotonic() < self._controls_until

    @property
    def is_alone(self) -> bool:
        """Whether there can be no other server."""
        return self._database.is_sqlite

    def is_alive(self, identifier: str) -> bool:
        """Return whether a server lived at the last look, or had no time yet to say so after an outage."""
        spared = self._spared if time.monotonic() < self._spared_until else ()
        return identifier == self.id or any(
            each.id == identifier and (each.is_alive or each.id in spared) for each in self._others
        )

    def endpoints(self, host: str) -> list[str]:
        """Return where the run processes of a host reach a server, the nearest first."""
        alive = [each for each in self._others if each.is_alive and each.protocol == PROTOCOL]
        known = [(self.host, self.own_endpoints), *((each.host, each.endpoints) for each in alive)]
        return [
            address
            for its_host, addresses in known
            for address in addresses
            if its_host == host or not address.startswith("unix:")
        ]

    def is_taken(self) -> bool:
        """Return whether another server lives under this one's name, on a copy of its data folder.

        Waits until a row of an earlier life of this server on another machine has expired.
        """
        before: Member | None = None
        began = time.monotonic()
        while True:
            with self._database.read() as connection:
                own = next((each for each in members(connection) if each.id == self.id), None)
            if own is None or not own.is_alive:
                return False
            if own.host == self.host and set(own.endpoints) & set(self.own_endpoints):
                # The lock on the data folder says that it has ended.
                return False
            if before is not None and own.beat_at != before.beat_at:
                return True
            before = before or own
            if time.monotonic() - began > self._settings.server_lost_after_s:
                # Only a clock of the database that was set back lets it live still.
                return False
            time.sleep(min(self._settings.server_beat_s, self._settings.server_lost_after_s) / 2)

    def start(self, url: str) -> None:
        """Say that this server lives, at `url`, from now on."""
        self.url = url
        self._try_to_beat()
        self._thread.start()

    def close(self) -> None:
        """Leave, so that the next leader need not wait."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(timeout=_CLOSED_S)
        self._leadership.release()
        try:
            with self._database.write() as connection:
                connection.execute(delete(servers).where(servers.c.id == self.id))
        except SQLAlchemyError as error:
            log.warning("server_not_removed", error=type(error).__name__)

    def _loop(self) -> None:
        beat_s = _ALONE_BEAT_S if self._database.is_sqlite else self._settings.server_beat_s
        while not self._stopping.is_set():
            self._stopping.wait(beat_s)
            if not self._stopping.is_set():
                self._try_to_beat()

    def _try_to_beat(self) -> None:
        try:
            self.beat()
        except (SQLAlchemyError, OSError) as error:
            # The lease and the row end by themselves if the database stays away.
            log.warning("beat_failed", error=type(error).__name__)

    def beat(self) -> None:
        """Say once that this server lives, take or keep the lead, and look who else is there."""
        # Everything that ends a lease counts from here, before the query: a slow database shortens
        # the time for which this server may act, and never lengthens it.
        began = time.monotonic()
        self._write_row()
        # Before anything else: who judges the runs of others must know who lives.
        self._look(began)
        self._controls_until = began + self._settings.server_lost_after_s
        if self.is_fit():
            self._leadership.beat()
        else:
            self._leadership.release()

    def _look(self, began: float) -> None:
        """Look who else is there.

        After a time without the database the rows of all servers have ended, because nobody could prolong
        them: those that lived before are given as long as any server may be silent.
        """
        lost_after_s = self._settings.server_lost_after_s
        with self._database.read() as connection:
            known = members(connection)
        if began - self._looked_at > lost_after_s:
            self._spared = frozenset(each.id for each in self._others if self.is_alive(each.id))
            self._spared_until = time.monotonic() + lost_after_s
        self._looked_at = began
        beats = {each.id: (each.beat_at, began) for each in known}
        # By when a row was first seen: what the database's clock shows may have been set back.
        self._beats = {
            name: self._beats[name] if name in self._beats and self._beats[name][0] == beat[0] else beat
            for name, beat in beats.items()
        }
        self._others = tuple(
            replace(each, is_alive=each.is_alive and began - self._beats[each.id][1] <= lost_after_s)
            for each in known
            if each.id != self.id
        )

    def _write_row(self) -> None:
        window_s = 3 * _ALONE_BEAT_S if self._database.is_sqlite else self._settings.server_lost_after_s
        with self._database.write() as connection:
            at = clock_time(connection)
            if not self._database.is_sqlite:
                follow(connection.execute(select(at)).scalar_one())
            values: dict[str, Any] = {
                "host": self.host,
                "hostname": socket.gethostname(),
                "url": self.url,
                "endpoints": list(self.own_endpoints),
                "version": self._version,
                "protocol": PROTOCOL,
                # Those of a cluster belong to none of the servers that use it.
                "slots": self._settings.local_slots if is_on_this_machine(self._settings) else 0,
                "gpus": self._gpus(),
                "beat_at": at,
                "expires_at": at + window_s,
            }
            mine = update(servers).where(servers.c.id == self.id)
            if not self._known:
                values["started_at"] = at
                connection.execute(delete(servers).where(servers.c.expires_at < at - _KEPT_S))
            if connection.execute(mine.values(**values)).rowcount == 0:
                connection.execute(insert(servers).values(**{"id": self.id, "started_at": at, **values}))
        self._known = True


def full_handle(membership: Membership, handle: Mapping[str, Any], executor: str) -> dict[str, Any]:
    """Return a handle that says by which executor, where and by which server its run was started."""
    return {"host": membership.host, **handle, "executor": executor, "server": membership.id}
