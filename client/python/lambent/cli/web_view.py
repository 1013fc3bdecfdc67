"""`lambent view`: one bundle and some light in the web viewer, served to this machine only."""

import contextlib
import re
import secrets
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import quote, unquote, urlencode, urlsplit

import lambent_pages
from lambent_pages.loopback import (
    DATA_HEADERS,
    LoopbackHandler,
    can_open_pages,
    ending_like_ctrl_c,
)
from lambent_pages.loopback import serving as serving_pages
from lambent_relight.bundle.bundle import Bundle, load_bundle
from lambent_relight.environment.input import EnvironmentInput, open_environment
from lambent_relight.environment.maps import write_environment

from lambent.cli.output import Output
from lambent.cli.rendering import relight_errors
from lambent.errors import UsageProblemError

_PIECE_BYTES = 1 << 20
_FILE_HEADERS = {"content-type": "application/octet-stream", **DATA_HEADERS}


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

        The key is in the fragment, which browsers keep to themselves. The second map is the one that the
        first is compared with; further ones are reached by their address only.
        """
        state = [("src", f"/show/{self.key}/bundle/")]
        state += [
            (name, f"url:/show/{self.key}/light/{quote(file)}")
            for name, file in zip(("env", "envB"), self.light, strict=False)
        ]
        return f"/viewer.html#{urlencode(state, safe='/:')}"


class _Handler(LoopbackHandler):
    def __init__(self, *given: Any, exhibit: Exhibit) -> None:
        self._exhibit = exhibit
        super().__init__(*given, pages=exhibit.pages)

    def do_GET(self) -> None:  # noqa: N802 - the base class asks for it
        """Answer with a file."""
        self._answer(with_body=True)

    def do_HEAD(self) -> None:  # noqa: N802 - the base class asks for it
        """Answer with the headers of a file."""
        self._answer(with_body=False)

    def _answer(self, *, with_body: bool) -> None:
        if self.refuse_strangers():
            return
        folder, _, rest = unquote(urlsplit(self.path).path).lstrip("/").partition("/")
        if folder == "show":
            self._send_shown(rest, with_body=with_body)
        else:
            self.send_page("viewer.html", with_body=with_body)

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
        self.send(HTTPStatus.NOT_FOUND, {}, b"")

    def _stream(self, open_file: Callable[[], Any], size_bytes: int, with_body: bool) -> None:
        self.send(HTTPStatus.OK, _FILE_HEADERS, b"", size_bytes)
        if with_body:
            # The browser may hang up at any time.
            with contextlib.suppress(BrokenPipeError, ConnectionResetError), open_file() as file:
                while piece := file.read(_PIECE_BYTES):
                    self.wfile.write(piece)


@contextlib.contextmanager
def serving(exhibit: Exhibit) -> Iterator[str]:
    """Yield the link to the viewer, on a free port of this machine; nobody else can reach it."""
    with serving_pages(lambda *given: _Handler(*given, exhibit=exhibit)) as origin:
        yield f"{origin}{exhibit.address()}"


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
            if not output.as_json and can_open_pages():
                open_page(url)
            (wait or threading.Event().wait)()
