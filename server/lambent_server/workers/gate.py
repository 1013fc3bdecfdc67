"""The gate that calls of run processes pass before they are read: the token, and the limits of each run."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import grpc

from lambent_server.api.problems import Problem
from lambent_server.core.metrics import WORKER_CALLS_REFUSED
from lambent_server.core.secrets import is_run_token
from lambent_server.core.settings import Settings
from lambent_server.workers.text import admit

THREADS = 24
"""Calls that are answered at the same time."""
MAX_STREAMS = 12
"""How many of them may be transfers of files, which take long: the other threads are free for heartbeats."""
STREAMS_OF_RUN = 4
"""How many transfers one run may have under way."""
STREAM_S = 1800.0
"""Time after which a transfer is broken off; runs themselves give one up after half of it."""
TRANSACTION_SHARE = 0.25
"""Part of the time for which the transactions of one run may be open: with SQLite nobody else writes then."""
_TRANSACTION_BURST_S = 20.0
_HEARTBEAT = "/Heartbeat"
_BURST_S = 4.0
_FORGET_AFTER_S = 60.0
_TOO_MANY_RUNS = 1000


@dataclass(slots=True)
class _Use:
    """What a run uses of its share."""

    calls: int
    streams: int
    allowance: float
    transactions_s: float
    at: float


class Shares:
    """Counts the calls of every run. Safe to use from several threads."""

    def __init__(self, calls: int, calls_per_s: float, streams: int = MAX_STREAMS) -> None:
        self._calls = calls
        self._rate = calls_per_s
        self._streams = streams
        self._lock = threading.Lock()
        self._uses: dict[str, _Use] = {}
        self._num_streams = 0

    @classmethod
    def of(cls, settings: Settings) -> "Shares":
        """Return the shares that the settings give to runs."""
        return cls(settings.worker_calls, settings.worker_calls_per_s)

    @contextmanager
    def timed(self, job_id: str, run: int) -> Iterator[Callable[[], None]]:
        """Count the time of a transaction towards the share of its run.

        Yields what to call once the transaction has its lock; it must have ended with the `with` block.
        """
        began: list[float] = []
        try:
            yield lambda: began.append(time.monotonic())
        finally:
            with self._lock:
                if began and (use := self._uses.get(f"{job_id}.{run}")) is not None:
                    use.transactions_s -= time.monotonic() - began[0]

    def enter(self, run: str, *, stream: bool, beats: bool = False) -> str:
        """Begin a call; return the reason why it is refused, or nothing if it may proceed.

        A heartbeat (`beats`) is let in even if the run's transactions took too long: without, it is lost.
        """
        at = time.monotonic()
        with self._lock:
            if len(self._uses) > _TOO_MANY_RUNS:
                self._forget(at)
            use = self._uses.setdefault(run, _Use(0, 0, _BURST_S * self._rate, _TRANSACTION_BURST_S, at))
            use.allowance = min(use.allowance + self._rate * (at - use.at), _BURST_S * self._rate)
            gained_s = TRANSACTION_SHARE * (at - use.at)
            use.transactions_s = min(use.transactions_s + gained_s, _TRANSACTION_BURST_S)
            use.at = at
            if use.transactions_s < 0.0 and not beats:
                return "transactions"
            if use.allowance < 1.0:
                return "rate"
            if use.calls >= self._calls:
                return "calls"
            if stream and (self._num_streams >= self._streams or use.streams >= STREAMS_OF_RUN):
                return "streams"
            use.allowance -= 1.0
            use.calls += 1
            use.streams += stream
            self._num_streams += stream
        return ""

    def leave(self, run: str, *, stream: bool) -> None:
        """End a call that was let in."""
        with self._lock:
            self._uses[run].calls -= 1
            self._uses[run].streams -= stream
            self._num_streams -= stream

    def _forget(self, at: float) -> None:
        old = [run for run, use in self._uses.items() if not use.calls and at - use.at > _FORGET_AFTER_S]
        for run in old:
            del self._uses[run]


class Gatekeeper(grpc.ServerInterceptor):  # type: ignore[type-arg]
    """Rejects unauthenticated calls before a thread waits for their data, and those beyond a run's share."""

    def __init__(self, secret: str, shares: Shares) -> None:
        self._secret = secret
        self._shares = shares

    def intercept_service(self, continuation: Any, details: Any) -> Any:
        """Return the handler of the call."""
        given = str(dict(details.invocation_metadata).get("authorization", ""))
        token = given.removeprefix("Bearer ")
        if not is_run_token(self._secret, token):
            # A stream handler, because other handlers read a message first.
            return grpc.stream_unary_rpc_method_handler(
                lambda _, context: context.abort(
                    grpc.StatusCode.UNAUTHENTICATED, "this is not a token of a run"
                )
            )
        handler = continuation(details)
        beats = details.method.endswith(_HEARTBEAT)
        return None if handler is None else self._limited(handler, token.rpartition(".")[0], beats)

    def _limited(self, handler: Any, run: str, beats: bool) -> Any:
        """Return a handler that first takes a place of the run's share."""
        given = {
            "request_deserializer": handler.request_deserializer,
            "response_serializer": handler.response_serializer,
        }
        if handler.response_streaming:
            return grpc.unary_stream_rpc_method_handler(self._stream(handler.unary_stream, run), **given)
        if handler.request_streaming:
            return grpc.stream_unary_rpc_method_handler(
                self._single(handler.stream_unary, run, True), **given
            )
        return grpc.unary_unary_rpc_method_handler(
            self._single(handler.unary_unary, run, False, beats), **given
        )

    @contextmanager
    def _place(self, context: Any, run: str, stream: bool, beats: bool = False) -> Iterator[None]:
        """Take a place of the run's share, and give it back after the call."""
        if reason := self._shares.enter(run, stream=stream, beats=beats):
            WORKER_CALLS_REFUSED.labels(reason).inc()
            context.abort(grpc.StatusCode.RESOURCE_EXHAUSTED, f"too many calls ({reason}); try again")
        try:
            with _time_limit(context, stream):
                yield
        finally:
            self._shares.leave(run, stream=stream)

    def _single(
        self, behavior: Callable[[Any, Any], Any], run: str, stream: bool, beats: bool = False
    ) -> Callable[[Any, Any], Any]:
        def act(request: Any, context: Any) -> Any:
            with self._place(context, run, stream, beats):
                return behavior(_admitted(request, context, stream=stream), context)

        return act

    def _stream(
        self, behavior: Callable[[Any, Any], Iterator[Any]], run: str
    ) -> Callable[[Any, Any], Iterator[Any]]:
        def act(request: Any, context: Any) -> Iterator[Any]:
            with self._place(context, run, True):
                yield from behavior(_admitted(request, context, stream=False), context)

        return act


def _admitted(request: Any, context: Any, *, stream: bool) -> Any:
    """Return a message, or the messages of a stream, whose texts and numbers have been checked."""
    if stream:
        return (_admitted(message, context, stream=False) for message in request)
    try:
        admit(request)
    except Problem as problem:
        context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"{problem.code}: {problem.detail}")
    return request


@contextmanager
def _time_limit(context: Any, stream: bool) -> Iterator[None]:
    """Break a transfer off that never ends, whose thread waits for the next message."""
    if not stream:
        yield
        return
    timer = threading.Timer(STREAM_S, context.cancel)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
