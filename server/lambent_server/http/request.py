"""One request on its way: the limits of its body, its time-outs, and the headers of every response."""

import asyncio
import json
import random
import re
import time
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

import structlog
from starlette.datastructures import Headers, MutableHeaders

from lambent_server.api.outside_text import announced_bytes
from lambent_server.api.problems import MEDIA_TYPE, Detail, Problem
from lambent_server.core.clock import new_id
from lambent_server.core.metrics import REQUEST_SECONDS
from lambent_server.http import cross_origin
from lambent_server.http.budget import BODIES, REQUESTS, Place
from lambent_server.services import Services

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

log = structlog.get_logger()

# The pages contain no secrets: they request their data with a cookie.
PUBLIC = re.compile(
    r"/|/assets/.*|/[a-z0-9._-]+\.(html|js|css|svg|json|wasm)|/healthz|/readyz"
    r"|/v1/(version|provenance-key|login|sign-in(/callback)?)|/embed/[^/]+(/picture)?"
)
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
# The largest body of a request to one of these, which has no authentication yet: a code.
_PUBLIC_BYTES = 16 * 1024
# A body that has not arrived after this time counts as being sent.
AT_ONCE_S = 1.0
# Windows are up to this many times longer than set: clients that began together are not cut off together.
LONGER = 1.2
# In the state of a request whose body was not read to its end: its connection has to be closed.
CUT_OFF = "cut_off"
_METHODS = SAFE | {"POST", "PUT", "PATCH", "DELETE"}
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


class Exchange:
    """One request: counts and times the parts of its body, and adds the headers of every response."""

    def __init__(self, services: Services, scope: Scope, receive: Receive, send: Send, place: Place) -> None:
        self.id = new_id("req")
        self._services = services
        self._settings = services.settings
        self._scope = scope
        self._receive = receive
        self._send = send
        self._limit = body_limit(services, scope["method"], scope["path"])
        self._place = place
        public = PUBLIC.fullmatch(scope["path"]) is not None
        window_s = self._settings.header_timeout_s if public else self._settings.body_window_s
        self._window_s = window_s * random.uniform(1.0, LONGER)  # noqa: S311
        self._waited = 0.0
        self._received = 0
        self._complete = False
        self._window: list[float] = [0.0, 0]
        self._answered = False
        self._cut = False
        self.stalled = False
        """Whether the client stopped accepting the response."""
        self._status = 0
        self._began = time.perf_counter()
        scope.setdefault("state", {})["request_id"] = self.id

    def check_length(self, headers: Headers) -> None:
        """Refuse a body whose announced length is too large, before reading it."""
        if announced_bytes(headers) > self._limit:
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
        except Problem as problem:
            return await self._cut_off(problem)
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
            if self._complete and self._place.kind == BODIES:
                self._place.move(REQUESTS, check=False)
        return message

    async def _next_piece(self) -> Message:
        """Wait for a piece; raises TimeoutError if too little arrived within a window.

        Raises the problem if the body does not arrive at once and too many others are being sent.
        """
        piece = asyncio.ensure_future(self._receive())
        try:
            while not piece.done():
                waited, brought = self._window
                patience_s = self._window_s - waited
                if self._place.kind == REQUESTS:
                    patience_s = min(patience_s, AT_ONCE_S - self._waited)
                began = time.monotonic()
                # Not wait_for, which would discard a piece that is on its way.
                await asyncio.wait({piece}, timeout=max(patience_s, 0.001))
                passed = time.monotonic() - began
                self._waited += passed
                waited += passed
                if waited >= self._window_s:
                    if brought < self._settings.body_bytes_per_s * waited:
                        raise TimeoutError
                    waited, brought = 0.0, 0
                self._window = [waited, brought]
                if not piece.done() and self._place.kind == REQUESTS and self._waited >= AT_ONCE_S:
                    self._place.move(BODIES, check=True)
        except BaseException:
            piece.cancel()
            raise
        return piece.result()

    async def _cut_off(self, problem: Problem) -> Message:
        await self.refuse(problem)
        self._cut = self._scope["state"][CUT_OFF] = True
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
            allow_store(headers, self._services)
            headers["x-request-id"] = self.id
            origin = self._scope["state"].get("cross_origin")
            if origin is not None:
                headers.update(cross_origin.allowing(origin))
                headers.add_vary_header("origin")
        try:
            async with asyncio.timeout(self._settings.send_timeout_s):
                await self._send(message)
        except TimeoutError as error:
            self.stalled = self._cut = True
            raise OSError("the client does not accept the response") from error

    async def answer(self, status: int, headers: dict[str, str], body: bytes = b"") -> None:
        """Respond."""
        pairs = [(name.encode(), value.encode()) for name, value in headers.items()]
        await self.send({"type": "http.response.start", "status": status, "headers": pairs})
        await self.send({"type": "http.response.body", "body": body})

    async def refuse(self, problem: Problem) -> None:
        """Respond with a problem, unless a response has already started."""
        if self._answered or self._cut:
            return
        body = json.dumps(problem.document(self.id)).encode()
        headers = {"content-type": MEDIA_TYPE, "content-length": str(len(body)), **problem.headers}
        await self.answer(problem.status, headers, body)

    def observe(self) -> None:
        """Count the request, and log it if it changed something or failed."""
        route = getattr(self._scope.get("route"), "path", "none")
        method, seconds = self._scope["method"], time.perf_counter() - self._began
        known = method if method in _METHODS else "other"
        REQUEST_SECONDS.labels(known, route, str(self._status)).observe(seconds)
        if method not in SAFE or self._status >= 500:
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


def allow_store(headers: MutableHeaders, services: Services) -> None:
    """Let pages exchange bytes with a store that they may send files to, or are redirected to."""
    bucket = services.store.bucket
    if bucket is not None and services.settings.store_direct:
        policy = headers["content-security-policy"]
        for directive in ("connect-src 'self'", "img-src 'self'"):
            policy = policy.replace(directive, f"{directive} {bucket.origin}")
        headers["content-security-policy"] = policy


def body_limit(services: Services, method: str, path: str) -> int:
    """Return how many bytes a request's body may have."""
    settings = services.settings
    if PUBLIC.fullmatch(path):
        return min(settings.max_json_bytes, _PUBLIC_BYTES)
    if method in ("PUT", "POST"):
        if re.fullmatch(r"/v1/scenes/[^/]+/(files/[^/]+|archive)", path):
            return settings.max_scene_bytes
        if path.endswith("/files:plan"):
            return settings.max_plan_bytes
        if path == "/v1/environments":
            return settings.max_environment_bytes
    return settings.max_json_bytes
