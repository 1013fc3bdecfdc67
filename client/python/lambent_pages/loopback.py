"""Serves pages to this machine only: a free port, for commands that show a page."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import lambent_pages

DATA_HEADERS = {
    "cache-control": "no-store",
    "x-content-type-options": "nosniff",
    "cross-origin-resource-policy": "same-origin",
    # What a user's files hold is data, never a page of this site.
    "content-security-policy": "default-src 'none'; sandbox",
}
"""Of everything but the pages; with a content type."""
_HOSTS = ("127.0.0.1", "localhost")


class LoopbackHandler(BaseHTTPRequestHandler):
    """Answers with the built pages in `pages`; subclasses add addresses of their own."""

    protocol_version = "HTTP/1.1"
    server_version = "lambent"
    # Methods without a function are answered with 501 by the base class.

    def __init__(self, *given: Any, pages: Path = lambent_pages.FOLDER) -> None:
        self._pages = pages
        super().__init__(*given)

    def log_message(self, *given: Any) -> None:
        """Keep quiet: the link is a secret."""

    def refuse_strangers(self) -> bool:
        """Return whether the request was for another host, after answering it.

        A page of another site whose name leads to this machine must not read anything.
        """
        if urlsplit(f"//{self.headers.get('host', '')}").hostname in _HOSTS:
            return False
        self.send(HTTPStatus.MISDIRECTED_REQUEST, {}, b"")
        return True

    def send_page(self, start: str, *, with_body: bool) -> None:
        """Answer with a file of the pages; `start` is the one without a path."""
        path = unquote(urlsplit(self.path).path).lstrip("/")
        encodings = self.headers.get("accept-encoding")
        page = lambent_pages.find(path or start, self._pages, accept_encoding=encodings)
        if page is None:
            absent = lambent_pages.not_found()
            self.send(HTTPStatus.NOT_FOUND, absent.headers, absent.content if with_body else b"")
        elif lambent_pages.is_named(page.headers["etag"], self.headers.get("if-none-match")):
            self.send(HTTPStatus.NOT_MODIFIED, page.headers, b"")
        else:
            self.send(HTTPStatus.OK, page.headers, page.content if with_body else b"", len(page.content))

    def send(self, status: HTTPStatus, headers: dict[str, str], body: bytes, size: int | None = None) -> None:
        """Answer with a body, of `size` bytes if it is sent by the caller or not at all."""
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("content-length", str(size or len(body)))
        self.end_headers()
        # The browser may hang up at any time.
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.wfile.write(body)


@contextlib.contextmanager
def serving(handler: Callable[..., LoopbackHandler]) -> Iterator[str]:
    """Yield the origin, such as `http://127.0.0.1:4711`, at which requests are answered by `handler`."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@contextlib.contextmanager
def ending_like_ctrl_c() -> Iterator[None]:
    """Let a termination or a closed terminal end this process as Ctrl-C does: with everything put away."""
    previous = {
        number: signal.signal(number, signal.default_int_handler)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def can_open_pages() -> bool:
    """Return whether there is a screen; without one the system may start a browser in the terminal."""
    return not sys.platform.startswith("linux") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
