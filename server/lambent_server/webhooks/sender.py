"""The thread that delivers webhooks: many at once, few of each tenant and host, each within a time limit."""

import asyncio
import contextlib
import socket
import ssl
import threading
import time
from collections.abc import Callable

import httpx2
import structlog
from sqlalchemy.exc import SQLAlchemyError

from lambent_server.core.metrics import WEBHOOK_ATTEMPTS
from lambent_server.core.settings import Settings
from lambent_server.services import Services
from lambent_server.storage.outages import report
from lambent_server.webhooks.claims import Claimed, Outcome, claim, release, settle
from lambent_server.webhooks.guard import Guard, RefusedAddress, Target
from lambent_server.webhooks.places import Places
from lambent_server.webhooks.signing import signed_headers

log = structlog.get_logger()

Resolver = Callable[[str, int], list[str]]
_MAX_ADDRESSES = 4
_MAX_RETRY_AFTER_S = 24 * 3600.0
_USER_AGENT = "lambent-webhooks/1"


def look_up(host: str, port: int) -> list[str]:
    """Return the addresses of a host name; empty if it has none."""
    try:
        infos = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError:
        return []
    return list(dict.fromkeys(str(each[4][0]) for each in infos))


class Sender:
    """Delivers what the outbox holds, while this server is the leader."""

    def __init__(
        self, services: Services, leads: Callable[[], bool], *, resolver: Resolver = look_up
    ) -> None:
        self._database = services.database
        self._settings = services.settings
        self._guard = Guard.of(services.settings)
        self._leads = leads
        self._resolver = resolver
        self._places = Places(services.settings)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._main: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """Stop at once; attempts that are under way are given back to the next server."""
        if self._loop is not None and self._main is not None:
            with contextlib.suppress(RuntimeError):
                self._loop.call_soon_threadsafe(self._main.cancel)
        if self._thread.is_alive():
            self._thread.join(timeout=5)

    def _run(self) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            asyncio.run(self._deliver())

    async def _deliver(self) -> None:
        self._loop, self._main = asyncio.get_running_loop(), asyncio.current_task()
        async with open_client(self._settings) as client, asyncio.TaskGroup() as group:
            while True:
                try:
                    for row in await self._claimed():
                        self._places.take(row.tenant_id, row.host)
                        group.create_task(self._handle(client, row))
                except (SQLAlchemyError, OSError) as error:
                    # The database is unavailable; the rows are still due once it is back.
                    report("webhooks_not_read", error)
                await asyncio.sleep(self._settings.webhook_poll_s)

    async def _claimed(self) -> list[Claimed]:
        if not self._places.free or not self._leads():
            return []
        return await asyncio.to_thread(claim, self._database, self._settings, self._places.copy())

    async def _handle(self, client: httpx2.AsyncClient, row: Claimed) -> None:
        try:
            outcome = await self.attempt(client, row)
            timed_out = outcome.error == "timeout"
            self._places.learn(row.tenant_id, row.host, seconds=outcome.seconds, timed_out=timed_out)
            state = await asyncio.to_thread(settle, self._database, self._settings, row, outcome)
        except asyncio.CancelledError:
            # Not awaited: this task is being ended, and the claim of a lost attempt ends by itself too.
            with contextlib.suppress(SQLAlchemyError):
                release(self._database, row)
            raise
        except (SQLAlchemyError, OSError):
            # Delivered, perhaps, but not noted: it is delivered again when the claim has ended.
            log.exception("webhook_not_noted", delivery=row.id)
            return
        finally:
            self._places.leave(row.tenant_id, row.host)
        WEBHOOK_ATTEMPTS.labels(outcome.error or "delivered").inc()
        log.info(
            "webhook_attempt",
            tenant=row.tenant_id,
            delivery=row.id,
            job=row.job_id,
            host=row.host,
            status=outcome.status,
            error=outcome.error,
            state=state,
        )

    async def attempt(self, client: httpx2.AsyncClient, row: Claimed) -> Outcome:
        """Make one attempt and return its outcome; whatever goes wrong is one."""
        if not row.secrets:
            # Its subscription was deleted, or its maker has left; nothing is sent without a signature.
            return Outcome(error="secret_missing")
        began = time.monotonic()
        status, error, retry_after_s = None, "timeout", 0.0
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(self._places.timeout_s(row.tenant_id, row.host)):
                try:
                    target = self._guard.parse(row.url)
                    addresses = self._guard.permitted(target, await self._addresses(target))
                    status, retry_after_s = await post(client, target, addresses, row)
                    error = "" if 200 <= status < 300 else "redirected" if 300 <= status < 400 else "status"
                except RefusedAddress as refused:
                    error = refused.code
                except httpx2.TimeoutException:
                    error = "timeout"
                except httpx2.HTTPError as failed:
                    error = "tls_failed" if _is_tls(failed) else "connection_failed"
                except Exception:
                    # One delivery that cannot be made must not keep the others from being made.
                    log.exception("webhook_not_sent", delivery=row.id)
                    error = "internal"
        seconds = time.monotonic() - began
        return Outcome(status=status, error=error, seconds=seconds, retry_after_s=retry_after_s)

    async def _addresses(self, target: Target) -> list[str]:
        if target.address is not None:
            return [target.host]
        loop = asyncio.get_running_loop()
        answer: asyncio.Future[list[str]] = loop.create_future()

        def resolve() -> None:
            addresses = self._resolver(target.host, target.port)
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(_settle, answer, addresses)

        # A daemon thread, so that a look-up that hangs does not keep the server from exiting.
        threading.Thread(target=resolve, name="webhook-lookup", daemon=True).start()
        return await answer


def _settle(answer: asyncio.Future[list[str]], addresses: list[str]) -> None:
    if not answer.done():
        answer.set_result(addresses)


def open_client(settings: Settings) -> httpx2.AsyncClient:
    """Return the HTTP client of deliveries.

    It keeps no connection, because a kept one is known by its address only and would be used for another host
    there; asks no proxy, which would look names up again; and keeps no cookies between requests of tenants.
    """
    context = httpx2.create_ssl_context()
    if settings.webhook_ca_file is not None:
        context.load_verify_locations(settings.webhook_ca_file)
    return httpx2.AsyncClient(
        verify=context,
        trust_env=False,
        follow_redirects=False,
        timeout=settings.webhook_timeout_s,
        limits=httpx2.Limits(max_keepalive_connections=0),
    )


async def post(
    client: httpx2.AsyncClient, target: Target, addresses: list[str], row: Claimed
) -> tuple[int, float]:
    """Send a delivery to the first address that accepts a connection.

    Returns the status and Retry-After in seconds; the body of the answer is not read.
    """
    body = row.body.encode()
    failed: httpx2.ConnectError | None = None
    for address in addresses[:_MAX_ADDRESSES]:
        request = httpx2.Request(
            "POST",
            target.url_at(address),
            headers={
                "host": target.host_header,
                "content-type": "application/json",
                "user-agent": _USER_AGENT,
                **signed_headers(row.secrets, row.id, int(time.time()), body),
            },
            content=body,
            # The certificate is checked against the name, though the connection goes to the address.
            extensions={"sni_hostname": target.host, "timeout": client.timeout.as_dict()},
        )
        try:
            response = await client.send(request, stream=True)
        except httpx2.ConnectError as error:
            failed = error
            continue
        client.cookies.clear()
        await response.aclose()
        return response.status_code, _retry_after_s(response.headers.get("retry-after", ""))
    assert failed is not None
    raise failed


def _retry_after_s(text: str) -> float:
    return min(float(text), _MAX_RETRY_AFTER_S) if text.isascii() and text.isdigit() else 0.0


def _is_tls(error: BaseException) -> bool:
    """Return whether an error comes from a failed handshake."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, ssl.SSLError):
            return True
        cause = cause.__cause__ or cause.__context__
    return False
