"""The outermost layer: checks host, identity, size and speed of a request before any route sees it."""

import re
from collections.abc import MutableMapping
from dataclasses import replace
from functools import partial
from typing import Any
from urllib.parse import SplitResult, quote, urlsplit

import structlog
from anyio import to_thread
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers

from lambent_server.accounts import audit
from lambent_server.accounts.scopes import READ
from lambent_server.accounts.shares import bundle_read, frame_ancestors, is_active, is_token
from lambent_server.accounts.who import Who
from lambent_server.api.fair_places import FairPlaces
from lambent_server.api.outside_text import check_target
from lambent_server.api.problems import Problem
from lambent_server.core.secrets import sha256_text
from lambent_server.database.tenancy import Tenant
from lambent_server.http import cross_origin, request_turns
from lambent_server.http.budget import SIGN_INS, Budget, Place, client_of_address, kind_of
from lambent_server.http.identity import cookie_token, share_of_token, who_of_key, who_of_session
from lambent_server.http.login_header import LOGIN_NAME
from lambent_server.http.rates import Rates
from lambent_server.http.rechecks import Identify, Rechecks
from lambent_server.http.request import PUBLIC, SAFE, App, Exchange, Message, Receive, Scope, Send
from lambent_server.http.request_turns import TURN, Turn
from lambent_server.services import Services
from lambent_server.storage.outages import outage_of

log = structlog.get_logger()

CSRF_HEADER = "x-lambent-csrf"
# Refusals for lack of rights; mistakes in requests are not recorded.
_RECORDED = frozenset({"scope_missing", "key_needed", "csrf"})
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?", re.ASCII)
_SENT_FILE = re.compile(r"/v1/scenes/[^/]+/files/[^/]+")


class Gate:
    """ASGI middleware around the whole application."""

    def __init__(
        self, app: App, services: Services, hosts: frozenset[str], share_secret: str, budget: Budget
    ) -> None:
        self._app = app
        self._services = services
        self._hosts = hosts
        self._share_secret = share_secret
        self._budget = budget
        self._rates = Rates(services.settings)
        self._turns = FairPlaces.shared(request_turns.THREADS, services.settings)
        self._rechecks = Rechecks(services.settings.stream_ping_s / 3)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        place = Place(self._budget, kind_of(scope["method"], scope["path"], headers))
        request = Exchange(self._services, scope, receive, send, place)
        try:
            with place:
                await self._answer(request, place, scope, headers)
        except Problem as problem:
            scope["state"]["refused"] = problem.code
            await request.refuse(problem)
        except Exception as error:
            if request.stalled:
                # Returning without the end of the response closes the connection.
                log.info("client_stalled", request=request.id, path=scope["path"][:200])
                return
            outage = outage_of(error)
            if outage is None:
                log.exception("request_failed", request=request.id, path=scope["path"])
            else:
                about = {"reason": outage.code, "error": type(error).__name__}
                log.warning("request_put_off", request=request.id, path=scope["path"], **about)
            await request.refuse(outage or INTERNAL)
        finally:
            request.observe()
            await self._record_refusal(scope)

    async def _record_refusal(self, scope: Scope) -> None:
        """Record that a known client was not allowed to do something."""
        who, code = scope["state"].get("who"), scope["state"].get("refused", "")
        if who is None or code not in _RECORDED:
            return
        try:
            # So that no one fills the log with refused reads, which nothing else limits.
            self._rates.take(who.tenant.id, scope["state"]["credential"])
        except Problem:
            log.warning("refusal_not_recorded", request=who.request_id, code=code)
            return
        await to_thread.run_sync(self._write_refusal, who, scope, code)

    def _write_refusal(self, who: Who, scope: Scope, code: str) -> None:
        action = getattr(scope.get("route"), "name", None) or scope["method"]
        try:
            with self._services.database.write() as connection:
                audit.record(connection, who, action, scope["path"], outcome=code)
        except (SQLAlchemyError, Problem) as error:
            if outage_of(error) is None:
                log.exception("refusal_not_recorded", request=who.request_id, code=code)
            else:
                log.warning("refusal_not_recorded", request=who.request_id, code=code)

    async def _answer(self, request: Exchange, place: Place, scope: Scope, headers: Headers) -> None:
        check_target(scope.get("raw_path") or quote(scope["path"]).encode(), scope["query_string"])
        self._check_host(headers)
        client = client_of_address(scope["client"][0] if scope.get("client") else "unknown")
        place.take(client)
        if place.kind == SIGN_INS:
            # Open to everyone, and each costs a write, or a request to the provider.
            self._rates.take_sign_in(client)
        allowed = await self._preflight(scope, headers)
        if allowed is not None:
            await request.answer(204, allowed)
            return
        await self._identify(scope, headers)
        who: Who | None = scope["state"].get("who")
        if who is not None:
            place.take(f"tenant {who.tenant.id}", scope["state"]["credential"])
            if _counts_as_write(scope):
                self._rates.take(who.tenant.id, scope["state"]["credential"])
        request.check_length(headers)
        if who is None:
            await self._app(scope, request.receive, request.send)
            return
        turn = scope["state"][TURN] = Turn(self._turns, who.tenant.id, scope["state"]["credential"])

        async def send(message: Message) -> None:
            # The client takes the response at its own pace.
            await turn.leave()
            await request.send(message)

        try:
            await self._app(scope, request.receive, send)
        finally:
            await turn.leave()

    def _check_host(self, headers: Headers) -> None:
        hosts = headers.getlist("host")
        # RFC 9112, 3.2: a proxy may have looked at the other one.
        if len(hosts) != 1 or not hosts[0]:
            given = f"{len(hosts)} Host headers" if len(hosts) > 1 else "no Host header"
            raise Problem(400, "header_invalid", f"the request has {given}; send exactly one")
        host = hosts[0]
        if _HOST.fullmatch(host) is None:
            # Links and redirects are made of it.
            raise Problem(400, "header_invalid", f"the Host header {host[:100]!r} is not a name and a port")
        name = _address(f"//{host}", "Host").hostname or ""
        if name not in self._hosts:
            raise Problem(
                421,
                "host_not_allowed",
                f"this server does not serve the host {host[:100]!r}; name it in LAMBENT_ALLOWED_HOSTS",
            )

    async def _preflight(self, scope: Scope, headers: Headers) -> dict[str, str] | None:
        """Return the answer to a browser that asks whether a page elsewhere may read a bundle, or None."""
        asked = cross_origin.preflight(scope["method"], scope["path"], headers)
        if asked is None:
            return None
        return await to_thread.run_sync(cross_origin.answer, self._services.database, *asked)

    async def _identify(self, scope: Scope, headers: Headers) -> None:
        if PUBLIC.fullmatch(scope["path"]):
            return
        client = await self._who_of(scope, headers)
        if client is None:
            raise Problem(
                401,
                "not_authenticated",
                "send 'Authorization: Bearer <key>' (the key is in api.key in the server's data folder), or "
                "open the one-time link that `lambent serve` printed",
                headers={"www-authenticate": 'Bearer realm="lambent"'},
            )
        state = scope["state"]
        address = scope["client"][0] if scope.get("client") else ""
        state["who"] = who = replace(client, address=address, request_id=state["request_id"])
        state["tenant"] = who.tenant
        if who.kind in ("session", "user") and scope["method"] not in SAFE:
            self._check_same_site(headers)

    async def _who_of(self, scope: Scope, headers: Headers) -> Who | None:
        """Return who makes a request: by key, by the secret of a share link, or by session."""
        database, method = self._services.database, scope["method"]
        state = scope.setdefault("state", {})
        scheme, _, key = headers.get("authorization", "").partition(" ")
        bearer = key.strip() if scheme.lower() == "bearer" else None
        state["by_key"] = bearer is not None and not is_token(bearer)
        if bearer is not None and state["by_key"]:
            state["credential"] = _name("key", bearer)
            return await self._identified(state, partial(who_of_key, self._services, bearer))
        if bearer is not None:
            bundle_id = bundle_read(method, scope["path"])
            if bundle_id is None:
                return None
            share = await to_thread.run_sync(share_of_token, database, self._share_secret, bearer, bundle_id)
            # The pages that a link names may also read that it has ended.
            if share is not None and headers.get("origin") in frame_ancestors(share):
                state["cross_origin"] = headers["origin"]
            if share is not None and is_active(share):
                state["by_share"] = True
                state["credential"] = f"link {share.id}"
                tenant = Tenant(share.tenant_id)
                return Who(tenant=tenant, kind="link", id=share.id, scopes=frozenset({READ}))
            return None
        token = cookie_token(headers.get("cookie", ""))
        state["credential"] = _name("session", token or "")
        if token is None:
            return None
        return await self._identified(state, partial(who_of_session, database, token, state.get(LOGIN_NAME)))

    async def _identified(self, state: MutableMapping[str, Any], identify: Identify) -> Who | None:
        """Return who makes a request, and keep for a stream how to ask that again."""
        asked = (state["credential"], state.get(LOGIN_NAME))
        state["identify"] = partial(self._rechecks.who, asked, identify)
        return await to_thread.run_sync(identify)

    @staticmethod
    def _check_same_site(headers: Headers) -> None:
        """Refuse a write that another site may have caused the browser to send."""
        origin = headers.get("origin")
        foreign = origin is not None and _address(origin, "Origin").netloc != headers.get("host")
        if headers.get(CSRF_HEADER) != "1" or foreign:
            raise Problem(
                403,
                "csrf",
                f"a browser's write needs the header {CSRF_HEADER}: 1 and must come from this site",
            )


def _counts_as_write(scope: Scope) -> bool:
    """Return whether a request changes something; files of a scene are limited by their number and bytes."""
    return scope["method"] not in SAFE and _SENT_FILE.fullmatch(scope["path"]) is None


def _name(kind: str, secret: str) -> str:
    """Return the name under which the requests with a key or a cookie are counted."""
    return f"{kind} {sha256_text(secret)}"


def _address(text: str, header: str) -> SplitResult:
    """Return the parts of the address in a header."""
    try:
        return urlsplit(text)
    except ValueError as error:
        raise Problem(400, "header_invalid", f"the header {header} is not an address") from error


INTERNAL = Problem(500, "internal", "internal error; see the server's log", retryable=True)
