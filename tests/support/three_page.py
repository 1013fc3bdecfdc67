"""A page that shows mesh files with three.js, in the browser of `support.chromium`."""

import base64
import contextlib
import math
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
from lambent_relight.cameras import Camera
from support.chromium import Page, browser

WEB = Path(__file__).resolve().parents[2] / "client" / "web"
PAGE = Path(__file__).with_name("three_page.html")


class _Files(SimpleHTTPRequestHandler):
    """Serves three.js, the page, and the files of one folder."""

    def __init__(self, *args: object, folder: Path, **kwargs: object) -> None:
        self._folder = folder
        super().__init__(*args, **kwargs)

    def translate_path(self, path: str) -> str:
        """Return where a path of a request lies."""
        name = path.partition("?")[0].lstrip("/")
        if name == "page.html":
            return str(PAGE)
        base = WEB if name.startswith("node_modules/three/") else self._folder
        return str(base / name)

    def log_message(self, *args: object) -> None:
        """Keep quiet."""


class ThreePage:
    """three.js with one mesh file loaded."""

    def __init__(self, page: Page, url: str) -> None:
        self._page, self._url = page, url

    def load(self, name: str) -> int:
        """Load a file of the folder and return its number of triangles."""
        self._page.open(f"{self._url}/page.html")
        self._page.wait("window.ready")
        return int(self._page.evaluate(f"load('{self._url}/{name}')"))

    def draw(self, kind: str, camera: Camera) -> np.ndarray:
        """Return bytes [height, width, 4]: "colour", "packed", "normal" or "lit", of a centred camera."""
        turn = np.eye(4)[[0, 2, 1, 3]] * np.array([[1.0], [1.0], [-1.0], [1.0]])
        pose = (turn @ camera.camera_to_world).ravel().tolist()
        field = math.degrees(2.0 * math.atan(0.5 * camera.height / camera.focal_y))
        call = f"draw('{kind}', {camera.width}, {camera.height}, {field!r}, {pose})"
        data = base64.b64decode(self._page.evaluate(call))
        return np.frombuffer(data, np.uint8).reshape(camera.height, camera.width, 4)


@contextlib.contextmanager
def three_page(folder: Path, profile: Path) -> Iterator[ThreePage]:
    """Yield a page that reads files of `folder`; the browser keeps its own in `profile`."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(_Files, folder=folder))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        with browser(profile) as page:
            yield ThreePage(page, f"http://127.0.0.1:{server.server_address[1]}")
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
