"""The web engine's reader of a bundle's graphs, onnxruntime-web, in the browser of `support.chromium`."""

import base64
import contextlib
import json
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import ClassVar

import numpy as np
from support.chromium import Page, browser

WEB = Path(__file__).resolve().parents[2] / "client" / "web"
WEBGPU = ("--enable-unsafe-webgpu", "--use-webgpu-adapter=swiftshader")
"""Flags of a browser that computes WebGPU in software."""
_WASM = WEB / "node_modules" / "onnxruntime-web" / "dist"
_TYPES = {".js": "text/javascript", ".mjs": "text/javascript", ".wasm": "application/wasm"}

Arrays = Mapping[str, np.ndarray]


class _Files(SimpleHTTPRequestHandler):
    """Serves the built page, onnxruntime's files, and one bundle."""

    extensions_map: ClassVar = {**SimpleHTTPRequestHandler.extensions_map, **_TYPES}

    def __init__(self, *args: object, page: Path, bundle: Path, **kwargs: object) -> None:
        self._folders = {"bundle": bundle, "ort": _WASM, "page": page}
        super().__init__(*args, **kwargs)

    def translate_path(self, path: str) -> str:
        """Return where a path of a request lies."""
        head, _, rest = path.partition("?")[0].lstrip("/").partition("/")
        return str(self._folders[head] / rest if head in self._folders else self._folders["page"] / head)

    def log_message(self, *args: object) -> None:
        """Keep quiet."""


class EnginePage:
    """Readers of one bundle, by name."""

    def __init__(self, page: Page) -> None:
        self._page = page

    @property
    def console(self) -> list[str]:
        """Errors reported by the browser."""
        return self._page.console

    def open(self, name: str, path: str, provider: str, outputs: Sequence[str] | None = None) -> bool:
        """Open a graph with "wasm" or "webgpu"; returns whether float16 tables stayed as they are."""
        return bool(self._call("open", name, path, provider, *([] if outputs is None else [list(outputs)])))

    def run(self, name: str, inputs: Arrays) -> dict[str, np.ndarray]:
        """Return a graph's outputs [row, n] for inputs [row, n]."""
        rows = len(next(iter(inputs.values())))
        found = self._call("run", name, _texts(inputs), _widths(inputs))
        return {key: _array(text, rows) for key, text in found.items()}

    def trace(self, path: str, backend: str, rays: np.ndarray) -> tuple[dict[str, np.ndarray], str, str]:
        """Return what the tracer of the refinement finds for rays [ray, 6], its backend, and its note."""
        found = self._call("trace", path, backend, _text(rays))
        taken, note = found.pop("backend"), found.pop("note")
        return {key: _array(text, len(rays)) for key, text in found.items()}, taken, note

    def time(self, name: str, inputs: Arrays, times: int) -> float:
        """Return the shortest of some runs of a graph, in milliseconds."""
        return float(self._call("time", name, _texts(inputs), _widths(inputs), times))

    def _call(self, function: str, *arguments: object) -> object:
        given = ", ".join(json.dumps(argument) for argument in arguments)
        return self._page.evaluate(f"engine.{function}({given})")


def _text(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()


def _texts(inputs: Arrays) -> dict[str, str]:
    return {name: _text(values) for name, values in inputs.items()}


def _widths(inputs: Arrays) -> dict[str, int]:
    return {name: values.shape[1] for name, values in inputs.items()}


def _array(text: str, rows: int) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4").reshape(rows, -1)


def build_page(folder: Path) -> None:
    """Write the page and its modules into `folder`, from client/web/tests/onnxPage.ts."""
    rolldown = WEB / "node_modules" / ".bin" / "rolldown"
    command = [str(rolldown), "tests/onnxPage.ts", "--dir", str(folder), "--format", "esm"]
    subprocess.run(command, cwd=WEB, check=True, capture_output=True)
    icon = '<link rel="icon" href="data:,">'
    script = '<script type="module" src="onnxPage.js"></script>'
    (folder / "index.html").write_text(f"<!doctype html>{icon}{script}")


@contextlib.contextmanager
def engine_page(bundle: Path, folder: Path) -> Iterator[EnginePage]:
    """Yield the readers of the bundle in `bundle`; page and browser keep what they need in `folder`."""
    build_page(folder / "page")
    handler = partial(_Files, page=folder / "page", bundle=bundle)
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        with browser(folder / "profile", more=WEBGPU) as page:
            page.open(f"http://127.0.0.1:{server.server_address[1]}/index.html")
            page.wait("window.engine !== undefined")
            yield EnginePage(page)
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
