"""Requests of the page that corrects masks, below an address that nobody can guess."""

import json
import secrets
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

import lambent_pages
from lambent_core.errors import WorkerError
from lambent_pages.loopback import DATA_HEADERS, LoopbackHandler

from lambent_capture.masks.corrections import Correction, parse_corrections, record_of
from lambent_capture.masks.editing import EditedMasks, Editing, Superseded

MOST_BYTES = 4 << 20
"""Of a request's body."""
PAGE = "masks.html"


@dataclass(frozen=True, kw_only=True)
class Desk:
    """What one page works on."""

    editing: Editing
    corrections: Sequence[Correction]
    """The ones to begin with."""
    keep: Callable[[Sequence[Correction]], None]
    """Called with all corrections after every change."""
    command: str
    """What a person types when the masks are right."""
    pages: Path = lambent_pages.FOLDER
    key: str = field(default_factory=lambda: secrets.token_urlsafe(16))
    done: threading.Event = field(default_factory=threading.Event)
    """Set when the person is done."""
    _keeping: threading.Lock = field(default_factory=threading.Lock)

    def take(self, corrections: Sequence[Correction]) -> None:
        """Keep corrections; raises `UsageError` for a frame that the capture does not have."""
        self.editing.require_frames(corrections)
        with self._keeping:
            self.keep(corrections)

    def address(self) -> str:
        """Return the address of the page, without the host; the key stays in the browser."""
        return f"/{PAGE}#key={self.key}"


class _NotAcceptedError(Exception):
    def __init__(self, status: HTTPStatus, code: str, detail: str) -> None:
        super().__init__(detail)
        self.status, self.code = status, code


class DeskHandler(LoopbackHandler):
    """Answers the page's requests: `/edit/KEY/...`, and the pages themselves.

    `GET capture`, `GET picture?frame=&side=` (JPEG), `GET mask?frame=` (PNG), `POST corrections`, `POST
    finish`, the last two with the JSON document of all corrections.
    """

    def __init__(self, *given: Any, desk: Desk) -> None:
        self._desk = desk
        super().__init__(*given, pages=desk.pages)

    def do_GET(self) -> None:  # noqa: N802 - the base class asks for it
        """Answer with a picture, a mask, a description of the capture, or a file of the pages."""
        self._answer(self._get)

    def do_POST(self) -> None:  # noqa: N802 - the base class asks for it
        """Take corrections."""
        self._answer(self._post)

    def _answer(self, act: Callable[[str], None]) -> None:
        if self.refuse_strangers():
            return
        area, _, rest = unquote(urlsplit(self.path).path).lstrip("/").partition("/")
        if area != "edit":
            self.send_page(PAGE, with_body=True)
            return
        key, _, what = rest.partition("/")
        try:
            if not secrets.compare_digest(key.encode(), self._desk.key.encode()):
                raise _not_found()
            act(what)
        except _NotAcceptedError as error:
            self._send_json({"code": error.code, "detail": str(error)}, error.status)
        except WorkerError as error:
            self._send_json({"code": error.code, "detail": error.message}, HTTPStatus.UNPROCESSABLE_ENTITY)

    def _get(self, what: str) -> None:
        if what == "capture":
            self._send_json(self._capture())
        elif what in ("picture", "mask"):
            asked = parse_qs(urlsplit(self.path).query)
            name, side = asked.get("frame", [""])[0], asked.get("side", ["0"])[0]
            if not self._desk.editing.has(name) or not side.isdecimal():
                raise _not_found()
            if what == "mask":
                self._send_data("image/png", self._desk.editing.mask_png(name))
            else:
                self._send_data("image/jpeg", self._desk.editing.picture_jpeg(name, int(side[:6])))
        else:
            raise _not_found()

    def _post(self, what: str) -> None:
        if what not in ("corrections", "finish"):
            raise _not_found()
        corrections = parse_corrections(self._body(), "what the page has sent")
        # Kept before they are drawn: whatever happens now, nobody marks them again.
        self._desk.take(corrections)
        if what == "finish":
            self._send_json({"command": self._desk.command})
            self._desk.done.set()
            return
        try:
            edited = self._desk.editing.apply(corrections)
        except Superseded:
            raise _NotAcceptedError(
                HTTPStatus.CONFLICT, "masks.superseded", "later corrections came"
            ) from None
        self._send_json(_record(edited))

    def _capture(self) -> dict[str, Any]:
        editing = self._desk.editing
        doubtful = set(editing.last.doubtful)
        sizes = {name: editing.size(name) for name in editing.work.names}
        frames = [
            {"name": name, "width": width, "height": height, "doubtful": name in doubtful}
            for name, (width, height) in sizes.items()
        ]
        return {
            "frames": frames,
            "corrections": record_of(self._desk.corrections),
            "agreement": editing.last.overlap,
            "reason": editing.last.reason,
        }

    def _body(self) -> str:
        """Return the text that was sent; requests of other sites' pages are refused."""
        origin, host = self.headers.get("origin"), self.headers.get("host", "")
        if origin is not None and origin != f"http://{host}":
            raise _NotAcceptedError(HTTPStatus.FORBIDDEN, "masks.other_site", "another site has asked")
        if self.headers.get_content_type() != "application/json":
            raise _NotAcceptedError(HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "masks.not_json", "send JSON")
        length = self.headers.get("content-length", "")
        if not length.isdecimal() or int(length[:12]) > MOST_BYTES:
            self.close_connection = True
            raise _NotAcceptedError(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "masks.too_long", "too many corrections; undo some"
            )
        return self.rfile.read(int(length)).decode(errors="replace")

    def _send_json(self, record: dict[str, Any], status: HTTPStatus = HTTPStatus.OK) -> None:
        self._send_data("application/json", json.dumps(record).encode(), status)

    def _send_data(self, kind: str, body: bytes, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send(status, {"content-type": kind, **DATA_HEADERS}, body)


def _not_found() -> _NotAcceptedError:
    return _NotAcceptedError(HTTPStatus.NOT_FOUND, "not_found", "there is nothing at this address")


def _record(edited: EditedMasks) -> dict[str, Any]:
    return {
        "agreement": edited.overlap,
        "doubtful": list(edited.doubtful),
        "changed": list(edited.changed),
        "reason": edited.reason,
    }
