"""One HTTP connection to a server: keys, time-outs, retries, and problem documents as exceptions."""

import json
import random
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2

from lambent.errors import LambentError, UnreachableError, problem_error
from lambent.settings import ServerAddress

RETRIED_STATUS = frozenset({429, 502, 503, 504})
"""Answers after which a request that may be repeated is repeated."""

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
        from lambent import __version__

        headers = {"User-Agent": f"lambent/{__version__}"}
        if address.api_key:
            headers["Authorization"] = f"Bearer {address.api_key}"
        self.address = address
        self._sleep = sleep
        self._client = httpx2.Client(
            base_url=address.url,
            headers=headers,
            timeout=httpx2.Timeout(READ_TIMEOUT_S, connect=5.0),
            transport=transport,
            # A proxy from the environment must not be asked for this machine's own server.
            trust_env=not address.is_loopback,
        )

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

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
                self._sleep(_pause_s(attempt))
                continue
            if response.status_code in RETRIED_STATUS and attempt < num_tries:
                self._sleep(_pause_s(attempt, response.headers.get("Retry-After")))
                continue
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
        advance: Callable[[int], None] = lambda sent_bytes: None,
        **request: Any,
    ) -> Any:
        """Return `json` of a request whose body is a file; `advance` is called with the bytes sent."""

        def pieces() -> Iterator[bytes]:
            sent_bytes = 0
            with source.open("rb") as file:
                while piece := file.read(PIECE_BYTES):
                    yield piece
                    sent_bytes += len(piece)
                    advance(sent_bytes)

        headers = {"Content-Length": str(source.stat().st_size), "Content-Type": media_type}
        return self.json(method, path, make_content=pieces, headers=headers, **request)

    @contextmanager
    def stream(
        self, path: str, *, headers: Mapping[str, str] | None = None, timeout_s: float, **request: Any
    ) -> Iterator[httpx2.Response]:
        """Open a GET whose body is read piece by piece; tried once, `timeout_s` without a byte ends it."""
        timeout = httpx2.Timeout(timeout_s, connect=5.0)
        try:
            with self._client.stream("GET", path, headers=headers, timeout=timeout, **request) as response:
                if response.status_code >= 400:
                    response.read()
                    _raise_for_problem(response)
                yield response
        except httpx2.TransportError as error:
            raise _unreachable(self.address, error) from error


def _pause_s(attempt: int, retry_after: str | None = None) -> float:
    if retry_after and retry_after.isdigit():
        return min(float(retry_after), 30.0)
    # Spread out, so that many clients of a restarted server do not come back in step.
    return min(0.25 * 2.0 ** (attempt - 1), 5.0) * random.uniform(0.75, 1.25)  # noqa: S311


def _unreachable(address: ServerAddress, error: Exception) -> UnreachableError:
    what = str(error) or type(error).__name__
    return UnreachableError(
        "server.unreachable",
        f"no answer from {address.url} ({what})",
        "check that it runs (`lambent serve`, `lambent doctor`) and that LAMBENT_URL is right",
    )


def _raise_for_problem(response: httpx2.Response) -> None:
    if response.status_code < 400:
        return
    try:
        problem = json.loads(response.content)
    except ValueError:
        problem = {}
    raise problem_error(response.status_code, problem if isinstance(problem, dict) else {})
