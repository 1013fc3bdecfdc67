"""`lambent view`: one bundle and some light in the web viewer, served to this machine only."""

import contextlib
import os
import re
import secrets
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlencode, urlsplit

import lambent_pages
from lambent_relight.bundle.bundle import Bundle, load_bundle
from lambent_relight.environment.input import EnvironmentInput, open_environment
from lambent_relight.environment.maps import write_environment

from lambent.cli.output import Output
from lambent.cli.rendering import relight_errors
from lambent.errors import UsageProblemError
from lambent.local_server import ending_like_ctrl_c

_PIECE_BYTES = 1 << 20
_DATA_HEADERS = {
    "content-type": "application/octet-stream",
    "cache-control": "no-store",
    "x-content-type-options": "nosniff",
    "cross-origin-resource-policy": "same-origin",
    # Files of a bundle are data, never pages of this site.
    "content-security-policy": "default-src 'none'; sandbox",
}


@dataclass(frozen=True, kw_only=True)
class Exhibit:
    """The files that one viewer shows, below an address that nobody can guess."""

    bundle: Bundle
    light: dict[str, Path] = field(default_factory=dict)
    """Environment maps as OpenEXR in our convention, by the name they are served under."""
    pages: Path = lambent_pages.FOLDER
    key: str = field(default_factory=lambda: secrets.token_urlsafe(16))

    @cached_property
    def paths(self) -> frozenset[str]:
        """The manifest and the files it names."""
        return frozenset({"manifest.json", *(file.path for file in self.bundle.manifest.files)})

    def address(self) -> str:
        """Return the address of the viewer on this server, without the host.

        The key stands in the fragment, which browsers keep to themselves. The second map is the one that the
        first is compared with; further ones are reached by their address only.
        """
        state = [("src", f"/show/{self.key}/bundle/")]
        state += [
            (name, f"url:/show/{self.key}/light/{quote(file)}")
            for name, file in zip(("env", "envB"), self.light, strict=False)
        ]
        return f"/viewer.html#{urlencode(state, safe='/:')}"


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "lambent"
    # Only reading is offered: other methods are answered with 501 by the base class.

    def __init__(self, *given: Any, exhibit: Exhibit) -> None:
        self._exhibit = exhibit
        super().__init__(*given)

    def do_GET(self) -> None:
        """Answer with a file."""
        self._answer(with_body=True)

    def do_HEAD(self) -> None:
        """Answer with the headers of a file."""
        self._answer(with_body=False)

    def log_message(self, *given: Any) -> None:
        """Keep quiet: the link is a secret."""

    def _answer(self, *, with_body: bool) -> None:
        # A page of another site whose name leads to this machine must not read the bundle.
        name = urlsplit(f"//{self.headers.get('host', '')}").hostname
        if name not in ("127.0.0.1", "localhost"):
            self._send(HTTPStatus.MISDIRECTED_REQUEST, {}, b"")
            return
        path = unquote(urlsplit(self.path).path).lstrip("/")
        folder, _, rest = path.partition("/")
        if folder == "show":
            self._send_shown(rest, with_body=with_body)
            return
        page = lambent_pages.find(path or "viewer.html", self._exhibit.pages)
        if page is None:
            self._send(HTTPStatus.NOT_FOUND, {}, b"")
        elif lambent_pages.is_current(page, self.headers.get("if-none-match")):
            self._send(HTTPStatus.NOT_MODIFIED, page.headers, b"")
        else:
            self._send(HTTPStatus.OK, page.headers, page.content if with_body else b"", len(page.content))

    def _send_shown(self, rest: str, *, with_body: bool) -> None:
        key, _, named = rest.partition("/")
        kind, _, path = named.partition("/")
        source = self._exhibit.bundle.source
        if secrets.compare_digest(key.encode(), self._exhibit.key.encode()):
            if kind == "bundle" and path in self._exhibit.paths:
                self._stream(lambda: source.open(path), source.size_bytes(path), with_body)
                return
            if kind == "light" and path in self._exhibit.light:
                file = self._exhibit.light[path]
                self._stream(lambda: file.open("rb"), file.stat().st_size, with_body)
                return
        self._send(HTTPStatus.NOT_FOUND, {}, b"")

    def _stream(self, open_file: Callable[[], Any], size_bytes: int, with_body: bool) -> None:
        self._send(HTTPStatus.OK, _DATA_HEADERS, b"", size_bytes)
        if with_body:
            # The browser may hang up at any time.
            with contextlib.suppress(BrokenPipeError, ConnectionResetError), open_file() as file:
                while piece := file.read(_PIECE_BYTES):
                    self.wfile.write(piece)

    def _send(
        self, status: HTTPStatus, headers: dict[str, str], body: bytes, size: int | None = None
    ) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("content-length", str(size or len(body)))
        self.end_headers()
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            self.wfile.write(body)


@contextlib.contextmanager
def serving(exhibit: Exhibit) -> Iterator[str]:
    """Yield the link to the viewer, on a free port of this machine; nobody else can reach it."""
    server = ThreadingHTTPServer(
        ("127.0.0.1", 0),
        lambda *given: _Handler(*given, exhibit=exhibit),  # type: ignore[arg-type]
    )
    server.daemon_threads = True
    thread = threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}{exhibit.address()}"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def write_light(
    environments: Sequence[Path], light: EnvironmentInput, folder: Path, note: Callable[[str], None]
) -> dict[str, Path]:
    """Write the maps to `folder` as the viewer reads them; return the files by the names to serve them under.

    Raises EnvironmentFileError for a map that cannot be used.
    """
    written = {}
    for number, path in enumerate(environments):
        opened = open_environment(path, light)
        for remark in opened.notes(path.name):
            note(remark)
        name = re.sub(r"[^A-Za-z0-9._-]+", "_", path.stem) or "light"
        target = folder / f"{number}-{name}.exr"
        write_environment(target, opened.environment.radiance)
        written[target.name] = target
    return written


def _can_open_pages() -> bool:
    """Return whether there is a screen; without one the system may start a browser in the terminal."""
    return not sys.platform.startswith("linux") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )


def view_in_browser(
    bundle: Path,
    environments: Sequence[Path],
    light: EnvironmentInput,
    output: Output,
    *,
    pages: Path = lambent_pages.FOLDER,
    open_page: Callable[[str], Any] = webbrowser.open,
    wait: Callable[[], Any] | None = None,
) -> None:
    """Show a bundle in the web viewer until Ctrl-C (or until `wait` returns).

    Raises `view.pages_not_built` where this copy of Lambent has no pages, and the errors of bundles and maps
    that cannot be used.
    """
    if not (pages / "viewer.html").is_file():
        raise UsageProblemError(
            "view.pages_not_built",
            "this copy of Lambent was installed from its sources, without the web pages",
            "run `make pages` in the checkout (needs Node 20), or add --desktop",
        )
    with tempfile.TemporaryDirectory(prefix="lambent-view-") as folder:
        with relight_errors():
            opened = load_bundle(bundle)
            maps = write_light(environments, light, Path(folder), output.note)
        exhibit = Exhibit(bundle=opened, light=maps, pages=pages)
        with ending_like_ctrl_c(), serving(exhibit) as url, contextlib.suppress(KeyboardInterrupt):
            output.result(f"viewer    {url}", {"url": url})
            output.note("Ctrl-C ends it.")
            if not output.as_json and _can_open_pages():
                open_page(url)
            (wait or threading.Event().wait)()
