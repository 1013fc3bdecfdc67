"""The outermost layer: checks host, identity, size and speed of a request before any route sees it."""

import asyncio
import json
import re
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any
from urllib.parse import SplitResult, urlsplit

import structlog
from anyio import to_thread
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers, MutableHeaders

from lambent_server.clock import new_id
from lambent_server.database.tenancy import Tenant
from lambent_server.http import cross_origin
from lambent_server.http.identity import cookie_token, share_of_token, tenant_of_key, tenant_of_session
from lambent_server.metrics import REQUEST_SECONDS
from lambent_server.problems import MEDIA_TYPE, Detail, Problem
from lambent_server.services import Services
from lambent_server.shares import COOKIE as SHARE_COOKIE
from lambent_server.shares import bundle_read, frame_ancestors, is_active, is_token

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

log = structlog.get_logger()

CSRF_HEADER = "x-lambent-csrf"
# The pages contain no secrets: they request their data with a cookie.
_PUBLIC = re.compile(
    r"/|/assets/.*|/[a-z0-9._-]+\.(html|js|css|svg|json|wasm)|/healthz|/readyz"
    r"|/v1/(version|login|shares:open)|/embed/[^/]+(/picture)?"
)
# The largest body of a request to one of these, which has no authentication yet: a code.
_PUBLIC_BYTES = 16 * 1024
_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_METHODS = _SAFE | {"POST", "PUT", "PATCH", "DELETE"}
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}


class Gate:
    """ASGI middleware around the whole application."""

    def __init__(self, app: App, services: Services, hosts: frozenset[str], share_secret: str) -> None:
        self._app = app
        self._services = services
        self._hosts = hosts
        self._share_secret = share_secret

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = _Request(self._services, scope, receive, send)
        try:
            headers = Headers(scope=scope)
            self._check_host(headers)
            allowed = await self._preflight(scope, headers)
            if allowed is not None:
                await request.answer(204, allowed)
                return
            await self._identify(scope, headers)
            request.check_length(headers)
            await self._app(scope, request.receive, request.send)
        except Problem as problem:
            await request.refuse(problem)
        except Exception as error:
            log.exception("request_failed", request=request.id, path=scope["path"])
            await request.refuse(unexpected(error))
        finally:
            request.observe()

    def _check_host(self, headers: Headers) -> None:
        host = headers.get("host", "")
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
        if _PUBLIC.fullmatch(scope["path"]):
            return
        tenant = await self._tenant_of(scope, headers)
        if tenant is None:
            raise Problem(
                401,
                "not_authenticated",
                "send 'Authorization: Bearer <key>' (the key is in api.key in the server's data folder), or "
                "open the one-time link that `lambent serve` printed",
                headers={"www-authenticate": 'Bearer realm="lambent"'},
            )
        scope.setdefault("state", {})["tenant"] = tenant

    async def _tenant_of(self, scope: Scope, headers: Headers) -> Tenant | None:
        """Return the tenant of a request: by key, else by the cookie of a share link, else by session."""
        database, method = self._services.database, scope["method"]
        state = scope.setdefault("state", {})
        scheme, _, key = headers.get("authorization", "").partition(" ")
        bearer = key.strip() if scheme.lower() == "bearer" else None
        bundle_id, cookies = bundle_read(method, scope["path"]), headers.get("cookie", "")
        by_header = bearer is not None and is_token(bearer)
        shared = bearer if by_header else cookie_token(cookies, SHARE_COOKIE)
        state["by_key"] = bearer is not None and not by_header
        if bearer is not None and not by_header:
            return await to_thread.run_sync(tenant_of_key, self._services, bearer)
        if bundle_id and shared:
            share = await to_thread.run_sync(share_of_token, database, self._share_secret, shared, bundle_id)
            # Cookies are of this site only, so that nobody elsewhere reads with those of a visitor. The pages
            # that a link names may read, too, that it has ended.
            if share is not None and by_header and headers.get("origin") in frame_ancestors(share):
                state["cross_origin"] = headers["origin"]
            if share is not None and is_active(share):
                state["by_share"] = True
                return Tenant(share["tenant_id"])
        if by_header:
            return None
        token = cookie_token(cookies)
        tenant = None if token is None else await to_thread.run_sync(tenant_of_session, database, token)
        if tenant is not None and method not in _SAFE:
            self._check_same_site(headers)
        return tenant

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


def _address(text: str, header: str) -> SplitResult:
    """Return the parts of the address in a header."""
    try:
        return urlsplit(text)
    except ValueError as error:
        raise Problem(400, "header_invalid", f"the header {header} is not an address") from error


def unexpected(error: Exception) -> Problem:
    """Return the response to an unexpected exception; the log has the details."""
    if isinstance(error, SQLAlchemyError):
        return Problem(503, "database_unavailable", "the database does not answer", retryable=True)
    return Problem(500, "internal", "internal error; see the server's log", retryable=True)


class _Request:
    """One request: counts the bytes of its body and adds the headers of every response."""

    def __init__(self, services: Services, scope: Scope, receive: Receive, send: Send) -> None:
        self.id = new_id("req")
        self._settings = services.settings
        self._scope = scope
        self._receive = receive
        self._send = send
        self._limit = body_limit(services, scope["method"], scope["path"])
        public = _PUBLIC.fullmatch(scope["path"]) is not None
        self._window_s = self._settings.header_timeout_s if public else self._settings.body_window_s
        self._received = 0
        self._complete = False
        self._window = [0.0, 0]
        self._answered = False
        self._cut = False
        self._status = 0
        self._began = time.perf_counter()
        scope.setdefault("state", {})["request_id"] = self.id

    def check_length(self, headers: Headers) -> None:
        """Refuse a body whose announced length is too large, before reading it."""
        text = headers.get("content-length")
        if text is not None and text.isdigit() and int(text) > self._limit:
            raise self._too_large()

    def _too_large(self) -> Problem:
        return Problem(
            413,
            "body_too_large",
            f"this request may bring {self._limit} bytes",
            errors=(Detail("#", f"at most {self._limit} bytes"),),
            headers={"connection": "close"},
        )

    async def receive(self) -> Message:
        """Return the next piece of the body, if it is in time and within the limits."""
        if self._cut:
            return {"type": "http.disconnect"}
        if self._complete:
            return await self._receive()
        try:
            message = await self._next_piece()
        except TimeoutError:
            return await self._cut_off(
                Problem(
                    408,
                    "body_too_slow",
                    f"a body must be sent at {self._settings.body_bytes_per_s:g} bytes per second",
                    retryable=True,
                    headers={"connection": "close"},
                )
            )
        if message["type"] == "http.request":
            size = len(message.get("body", b""))
            self._received += size
            self._window[1] += size
            self._complete = not message.get("more_body", False)
            if self._received > self._limit:
                return await self._cut_off(self._too_large())
        return message

    async def _next_piece(self) -> Message:
        """Wait for a piece; raises TimeoutError if too little arrived within a window."""
        waited, brought = self._window
        began = time.monotonic()
        message = await asyncio.wait_for(self._receive(), max(self._window_s - waited, 0.001))
        waited += time.monotonic() - began
        if waited >= self._window_s:
            if brought < self._settings.body_bytes_per_s * waited:
                raise TimeoutError
            waited, brought = 0.0, 0
        self._window = [waited, brought]
        return message

    async def _cut_off(self, problem: Problem) -> Message:
        await self.refuse(problem)
        self._cut = True
        return {"type": "http.disconnect"}

    async def send(self, message: Message) -> None:
        """Forward a response, with the headers that all responses have."""
        if self._cut:
            return
        if message["type"] == "http.response.start":
            self._answered = True
            self._status = message["status"]
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
            headers["x-request-id"] = self.id
            origin = self._scope["state"].get("cross_origin")
            if origin is not None:
                headers.update(cross_origin.allowing(origin))
        await self._send(message)

    async def answer(self, status: int, headers: dict[str, str]) -> None:
        """Respond without a body."""
        pairs = [(name.encode(), value.encode()) for name, value in headers.items()]
        await self.send({"type": "http.response.start", "status": status, "headers": pairs})
        await self.send({"type": "http.response.body", "body": b""})

    async def refuse(self, problem: Problem) -> None:
        """Respond with a problem, unless a response has already started."""
        if self._answered or self._cut:
            return
        body = json.dumps(problem.document(self.id)).encode()
        pairs = {"content-type": MEDIA_TYPE, "content-length": str(len(body)), **problem.headers}
        headers = [(name.encode(), value.encode()) for name, value in pairs.items()]
        await self.send({"type": "http.response.start", "status": problem.status, "headers": headers})
        await self.send({"type": "http.response.body", "body": body})

    def observe(self) -> None:
        """Count the request, and log it if it changed something or failed."""
        route = getattr(self._scope.get("route"), "path", "none")
        method, seconds = self._scope["method"], time.perf_counter() - self._began
        known = method if method in _METHODS else "other"
        REQUEST_SECONDS.labels(known, route, str(self._status)).observe(seconds)
        if method not in _SAFE or self._status >= 500:
            tenant = self._scope["state"].get("tenant")
            log.info(
                "request",
                request=self.id,
                tenant=tenant.id if tenant is not None else None,
                method=method,
                path=self._scope["path"][:200],
                status=self._status,
                seconds=round(seconds, 4),
            )


def body_limit(services: Services, method: str, path: str) -> int:
    """Return how many bytes a request's body may have."""
    settings = services.settings
    if _PUBLIC.fullmatch(path):
        return min(settings.max_json_bytes, _PUBLIC_BYTES)
    if method in ("PUT", "POST"):
        if re.fullmatch(r"/v1/scenes/[^/]+/(files/[^/]+|archive)", path):
            return settings.max_scene_bytes
        if path.endswith("/files:plan"):
            return settings.max_plan_bytes
        if path == "/v1/environments":
            return settings.max_environment_bytes
    return settings.max_json_bytes
