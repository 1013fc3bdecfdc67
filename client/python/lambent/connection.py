"""One HTTP connection to a server: keys, time-outs, retries, and problem documents as exceptions."""

import json
import random
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import httpx2

from lambent.errors import LambentError, UnreachableError, problem_error
from lambent.settings import ServerAddress

RETRIED_STATUS = frozenset({429, 502, 503, 504})
"""Answers after which a request that may be repeated is repeated."""

REDIRECT = "X-Lambent-Redirect"
"""Asks for the address of the store instead of the bytes."""

READ_TIMEOUT_S = 60.0
NUM_TRIES = 4
PIECE_BYTES = 1 << 20

TransferProgress = Callable[[str, int, int], None]
"""Called with (what is transferred, bytes done, bytes in all)."""


def ignore_progress(what: str, done_bytes: int, total_bytes: int) -> None:
    """Do nothing with the progress of a transfer."""


class Connection:
    """Requests relative to a server's base URL. Not for use by several threads at once.

    Requests that may be repeated (every GET, PUT and DELETE, a POST with an idempotency key, and what a
    caller marks `repeatable`) are tried `NUM_TRIES` times with growing pauses; the others once.
    """

    def __init__(
        self,
        address: ServerAddress,
        *,
        transport: httpx2.BaseTransport | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        headers = {"User-Agent": f"lambent/{version('lambent')}"}
        if address.api_key:
            headers["Authorization"] = f"Bearer {address.api_key}"
        self.address = address
        self.sleep = sleep
        self._transport = transport
        self._store: httpx2.Client | None = None
        self._client = httpx2.Client(
            base_url=address.url,
            headers=headers,
            timeout=httpx2.Timeout(READ_TIMEOUT_S, connect=5.0),
            transport=transport,
            # A proxy from the environment must not carry calls to this machine's own server.
            trust_env=not address.is_loopback,
        )

    def close(self) -> None:
        """Close the connection."""
        self._client.close()
        if self._store is not None:
            self._store.close()

    def _store_client(self) -> httpx2.Client:
        """Return the client for addresses of the store, which must never get the key."""
        if self._store is None:
            timeout = httpx2.Timeout(READ_TIMEOUT_S, connect=5.0)
            self._store = httpx2.Client(timeout=timeout, transport=self._transport)
        return self._store

    def put_to_store(
        self, url: str, headers: Mapping[str, str], source: Path, offset: int, size_bytes: int
    ) -> int:
        """Send a range of a file to an address of the store and return the status of the answer."""
        sent = {**headers, "Content-Length": str(size_bytes), "Content-Type": "application/octet-stream"}
        content = _pieces(source, offset, size_bytes)
        try:
            return self._store_client().put(url, content=content, headers=sent).status_code
        except httpx2.TransportError as error:
            raise _store_unreachable(url, error) from error

    def json(self, method: str, path: str, **request: Any) -> Any:
        """Return the decoded body of an answer (None when it is empty)."""
        response = self.send(method, path, **request)
        if not response.content:
            return None
        try:
            return response.json()
        except ValueError as error:
            media_type = response.headers.get("content-type", "no type")
            raise LambentError(
                "client.unexpected_answer",
                f"{method} {path} was answered with {media_type}, not JSON",
                "check that LAMBENT_URL points at a Lambent server and not at something in front of it",
            ) from error

    def pages(self, path: str, params: Mapping[str, Any] | None = None) -> Iterator[Any]:
        """Yield the entries of a list, page by page."""
        given = dict(params or {})
        while True:
            page = self.json("GET", path, params=given)
            yield from page["items"]
            if not page.get("next_cursor"):
                return
            given["cursor"] = page["next_cursor"]

    def send(
        self,
        method: str,
        path: str,
        *,
        headers: Mapping[str, str] | None = None,
        timeout_s: float = READ_TIMEOUT_S,
        repeatable: bool = False,
        make_content: Callable[[], Any] | None = None,
        **request: Any,
    ) -> httpx2.Response:
        """Return a successful answer, or raise the exception for its problem document.

        `make_content` is called anew for every try, so that a streamed body starts at its beginning.
        """
        headers = dict(headers or {})
        repeatable = repeatable or method != "POST" or "Idempotency-Key" in headers
        num_tries = NUM_TRIES if repeatable else 1
        for attempt in range(1, num_tries + 1):
            content = {"content": make_content()} if make_content else {}
            try:
                response = self._client.request(
                    method,
                    path,
                    headers=headers,
                    timeout=httpx2.Timeout(timeout_s, connect=5.0),
                    **content,
                    **request,
                )
            except httpx2.TransportError as error:
                if attempt == num_tries:
                    raise _unreachable(self.address, error) from error
                self.sleep(pause_s(attempt))
                continue
            if response.status_code in RETRIED_STATUS and attempt < num_tries:
                self.sleep(pause_s(attempt, response.headers.get("Retry-After")))
                continue
            if response.status_code == 307:
                response = self._read_from_store(response)
            _raise_for_problem(response)
            return response
        raise AssertionError("the loop above returns or raises")

    def upload(
        self,
        method: str,
        path: str,
        source: Path,
        *,
        media_type: str = "application/octet-stream",
        advance: Callable[[int], None] | None = None,
        **request: Any,
    ) -> Any:
        """Return `json` of a request whose body is a file; `advance` is called with the bytes sent."""
        size_bytes = source.stat().st_size
        headers = {"Content-Length": str(size_bytes), "Content-Type": media_type}
        pieces = partial(_pieces, source, 0, size_bytes, advance)
        return self.json(method, path, make_content=pieces, headers=headers, **request)

    def _read_from_store(self, redirect: httpx2.Response) -> httpx2.Response:
        url = redirect.headers["location"]
        try:
            return self._store_client().get(url)
        except httpx2.TransportError as error:
            raise _store_unreachable(url, error) from error

    @contextmanager
    def stream(
        self, path: str, *, headers: Mapping[str, str] | None = None, timeout_s: float, **request: Any
    ) -> Iterator[httpx2.Response]:
        """Open a GET whose body is read piece by piece; tried once, `timeout_s` without a byte ends it.

        The body comes from the server's store if it has an address for it that can be reached from here.
        """
        given = dict(headers or {})
        timeout = httpx2.Timeout(timeout_s, connect=5.0)
        with ExitStack() as stack:
            try:
                response = self._open(stack, path, {**given, REDIRECT: "1"}, timeout, request)
                if response.status_code == 307:
                    there = self._open_in_store(stack, response.headers["location"], given, timeout)
                    response = there or self._open(stack, path, given, timeout, request)
                if response.status_code >= 400:
                    response.read()
                    _raise_for_problem(response)
                yield response
            except httpx2.TransportError as error:
                raise _unreachable(self.address, error) from error

    def _open(
        self,
        stack: ExitStack,
        path: str,
        headers: Mapping[str, str],
        timeout: httpx2.Timeout,
        request: Mapping[str, Any],
    ) -> httpx2.Response:
        opened = self._client.stream("GET", path, headers=headers, timeout=timeout, **request)
        return stack.enter_context(opened)

    def _open_in_store(
        self, stack: ExitStack, url: str, headers: Mapping[str, str], timeout: httpx2.Timeout
    ) -> httpx2.Response | None:
        """Open an address of the store; None if it does not answer with the file."""
        # The store has ETags of its own, and the address names bytes that never change.
        given = {name: value for name, value in headers.items() if name.lower() == "range"}
        try:
            opened = self._store_client().stream("GET", url, headers=given, timeout=timeout)
            response = stack.enter_context(opened)
        except httpx2.TransportError:
            return None
        return response if response.status_code in (200, 206) else None


def _pieces(
    source: Path, offset: int, size_bytes: int, advance: Callable[[int], None] | None = None
) -> Iterator[bytes]:
    """Yield a range of a file, and call `advance` with the bytes that were sent."""
    sent_bytes = 0
    with source.open("rb") as file:
        file.seek(offset)
        while piece := file.read(min(PIECE_BYTES, size_bytes - sent_bytes)):
            yield piece
            sent_bytes += len(piece)
            if advance is not None:
                advance(sent_bytes)


def pause_s(attempt: int, retry_after: str | None = None) -> float:
    """Return how many seconds to wait after a number of attempts."""
    if retry_after and retry_after.isdigit():
        return min(float(retry_after), 30.0)
    # Spread out, so that many clients of a restarted server do not come back in step.
    return min(0.25 * 2.0 ** min(attempt - 1, 10), 5.0) * random.uniform(0.75, 1.25)  # noqa: S311


def _unreachable(address: ServerAddress, error: Exception) -> UnreachableError:
    what = str(error) or type(error).__name__
    return UnreachableError(
        "server.unreachable",
        f"no answer from {address.url} ({what})",
        "check that it runs (`lambent serve`, `lambent doctor`) and that LAMBENT_URL is right",
    )


def _store_unreachable(url: str, error: Exception) -> UnreachableError:
    host = httpx2.URL(url).netloc.decode()
    return UnreachableError(
        "store.unreachable",
        f"no answer from the server's store at {host} ({str(error) or type(error).__name__})",
        "check that this machine can reach it, or ask the server's operator for LAMBENT_STORE_DIRECT=false",
    )


def _raise_for_problem(response: httpx2.Response) -> None:
    if response.status_code < 400:
        return
    try:
        problem = json.loads(response.content)
    except ValueError:
        problem = {}
    raise problem_error(response.status_code, problem if isinstance(problem, dict) else {})
