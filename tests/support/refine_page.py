"""Refining in the web viewer, in the browser of `support.chromium`: a bundle of exact surfaces, and its page.

Boxes are drawn the same by mesh and `gbuffer`, so that pictures of browser and Python differ by noise alone.
What rays from them meet is answered by an untrained network of the kind that the fused readers know.
"""

from __future__ import annotations

import base64
import contextlib
import json
import subprocess
from collections.abc import Iterator, Sequence
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any

import lambent_pages
import numpy as np
import torch
from google.protobuf import json_format
from lambent_core.directions import pixel_directions
from lambent_pages.loopback import DATA_HEADERS, LoopbackHandler, serving
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight.baked.transport import transport_files
from lambent_relight.cameras import Camera
from lambent_relight.environment.maps import write_environment
from support.analytic_bundle import gbuffer_model, material_model, write_manifest
from support.analytic_scene import AnalyticScene, Box, Surface
from support.baked_bundle import baked_transport, boxes_surface, write_mesh
from support.chromium import Page, browser
from support.engine_page import WEB
from support.network_bundle import write_network_bundle
from support.preset_models import RULE, preset_model

SIZE = (40, 32)
"""Width and height of the picture."""
SCENE = AnalyticScene(
    (
        Box((-0.9, -0.9, -0.6), (0.9, 0.9, -0.4), Surface(albedo=(0.7, 0.6, 0.5), perceptual_roughness=0.8)),
        Box(
            (-0.3, -0.4, -0.4),
            (0.5, 0.3, 0.4),
            Surface(albedo=(0.9, 0.7, 0.3), perceptual_roughness=0.4, metalness=1.0),
        ),
    ),
    origin_offset=0.02,
)
_PAGE = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<link rel="stylesheet" href="small.css"><script type="module" src="lambent-viewer.js"></script>
<lambent-viewer controls></lambent-viewer>"""
_STYLE = """body { margin: 0 }
lambent-viewer { display: block; width: WIDTHpx; height: HEIGHTpx; min-height: 0 }"""


def write_refine_bundle(folder: Path) -> Path:
    """Write the bundle into `folder` and return it."""
    model = preset_model("tiny")
    with torch.no_grad():
        # The last number is the opacity's: neither open nor shut.
        model.fast.distance_head.weight[-1].normal_(0.0, 2.0)
        model.fast.distance_head.bias[-1] = -2.5
    write_network_bundle(folder, model, RULE)
    for name, model in (("gbuffer", gbuffer_model(SCENE)), ("material", material_model(SCENE))):
        (folder / "models" / f"{name}.onnx").write_bytes(model.SerializeToString())
    transport, _ = baked_transport(SCENE, 16, folder.with_name(folder.name + ".rays"))
    manifest = json_format.Parse((folder / "manifest.json").read_text(), BundleManifest())
    manifest.secondary_rays.origin_offset = SCENE.origin_offset
    files = transport_files(transport, manifest)
    write_mesh(folder, *boxes_surface(SCENE, 16), manifest)
    for path, data in files.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(data)
    write_manifest(folder, manifest)
    return folder


def write_light(path: Path) -> None:
    """Write a map without symmetry: a bright disc, a blue wall, a warm ground."""
    direction = pixel_directions(32, 64)
    x, y, z = np.moveaxis(direction, -1, 0)
    image = np.stack([0.3 + 0.1 * z, 0.3 + 0.1 * z, 0.4 + 0.2 * z], axis=-1)
    image[y > 0.6] += (0.1, 0.3, 1.2)
    image[(z < -0.3) & (x < 0.0)] += (0.8, 0.3, 0.0)
    towards = np.array([0.55, -0.35, 0.75]) / np.linalg.norm([0.55, -0.35, 0.75])
    image[direction @ towards > np.cos(np.radians(12.0))] += (9.0, 8.0, 6.0)
    write_environment(path, image.astype(np.float32))


class _Handler(LoopbackHandler):
    """Serves the built viewer, as `lambent view` does, and a folder of bundles and maps.

    Below strict/ the policy of workers forbids WebAssembly too. What was asked for is noted in a list.
    """

    def __init__(self, *given: object, pages: Path, data: Path, asked: list[str]) -> None:
        self._data, self._asked = data, asked
        super().__init__(*given, pages=pages)

    def do_GET(self) -> None:  # noqa: N802 - the base class asks for it
        """Answer with a file of the data, or with a page."""
        self._is_strict = self.path.startswith("/strict/")
        self.path = self.path.partition("?")[0].removeprefix("/strict")
        name = self.path.lstrip("/")
        self._asked.append(name)
        if not name.startswith("data/"):
            self.send_page("small.html", with_body=True)
            return
        file = self._data / name[5:]
        found = HTTPStatus.OK if file.is_file() else HTTPStatus.NOT_FOUND
        self.send(found, DATA_HEADERS, file.read_bytes() if file.is_file() else b"")

    def send(self, status: HTTPStatus, headers: dict[str, str], body: bytes, size: int | None = None) -> None:
        """Answer with the headers of our own servers, but for the policy below strict/."""
        strict = {"content-security-policy": lambent_pages.content_policy()} if self._is_strict else {}
        super().send(status, headers | strict, body, size)


def build_viewer(folder: Path) -> None:
    """Build the viewer into `folder`, and a page with one small element."""
    vite = WEB / "node_modules" / ".bin" / "vite"
    command = [str(vite), "build", "--outDir", str(folder), "--emptyOutDir", "--logLevel", "error"]
    subprocess.run(command, cwd=WEB, check=True, capture_output=True)
    (folder / "small.html").write_text(_PAGE)
    style = _STYLE.replace("WIDTH", str(SIZE[0])).replace("HEIGHT", str(SIZE[1]))
    (folder / "small.css").write_text(style)


class RefinePage:
    """A page with one viewer."""

    def __init__(self, page: Page, url: str, asked: list[str]) -> None:
        self.page, self._url = page, url
        self.asked = asked
        """Paths that were requested from the server since the page was opened."""

    def open(self, bundle: str, state: str = "", *, below: str = "", **options: object) -> None:
        """Open a bundle of the data folder; `options` are those of refining, `below` may be "strict/"."""
        self.page.open("about:blank")
        self.asked.clear()
        self.page.console.clear()
        self.page.open(f"{self._url}/{below}small.html")
        self.page.wait("document.querySelector('lambent-viewer')?.viewer != null")
        self.page.evaluate(
            f"""(() => {{
                const viewer = (globalThis.viewer = document.querySelector('lambent-viewer').viewer);
                viewer.refineOptions = {{ ...viewer.refineOptions, ...{json.dumps(options)} }};
                globalThis.statuses = [];
                viewer.on('refine', (status) => statuses.push(status));
                const element = document.querySelector('lambent-viewer');
                element.setAttribute('state', {json.dumps(state)});
                element.setAttribute('src', 'data/{bundle}/');
            }})()"""
        )
        self.page.evaluate("document.querySelector('lambent-viewer').ready")

    def wait(self, *phases: str) -> dict[str, Any]:
        """Return the first status from now on that is in one of `phases`."""
        wanted = json.dumps(phases)
        return self.page.wait(
            f"statuses.at(-1) && {wanted}.includes(statuses.at(-1).phase) && statuses.at(-1)", 240.0
        )

    def statuses(self) -> list[dict[str, Any]]:
        """Return every status since the page was opened."""
        return self.page.evaluate("statuses")

    def camera(self) -> Camera:
        """Return the camera of the picture."""
        found = self.page.evaluate(f"viewer.camera({SIZE[0]}, {SIZE[1]})")
        pose = np.array(found["cameraToWorld"]).reshape(4, 4)
        return Camera(
            name="shown",
            width=found["width"],
            height=found["height"],
            focal_x=found["focalX"],
            focal_y=found["focalY"],
            centre_x=found["centreX"],
            centre_y=found["centreY"],
            camera_to_world=pose,
        )

    def refined(self) -> dict[str, np.ndarray]:
        """Return the arrays of the refined picture that is shown, [height, width, n]."""
        names = ("directRgb", "indirectRgb", "standardErrorRgb", "visibility", "coverage")
        texts = self.page.evaluate(
            f"""(() => {{
                const text = (values) => {{
                    const bytes = new Uint8Array(values.buffer);
                    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(''));
                }};
                const picture = viewer.refined;
                return picture && {json.dumps(names)}.map((name) => text(picture[name]));
            }})()"""
        )
        assert texts is not None, "no refined picture is shown"
        shape = (SIZE[1], SIZE[0], -1)
        arrays = [np.frombuffer(base64.b64decode(text), "<f4").reshape(shape) for text in texts]
        return dict(zip(names, arrays, strict=True))

    def picture(self) -> np.ndarray:
        """Return what is seen as bytes [height, width, 4]."""
        found = self.page.evaluate(f"[...viewer.pixels({SIZE[0]}, {SIZE[1]})]")
        return np.array(found, np.uint8).reshape(SIZE[1], SIZE[0], 4)

    def press(self, key: str, code: int) -> dict[str, Any]:
        """Press a key on the picture, as a person does; returns what is so at that very moment."""
        self.page.evaluate(
            f"""(() => {{
                globalThis.pressed = null;
                viewer.canvas.focus();
                viewer.canvas.addEventListener('keydown', () => {{
                    const bytes = [...viewer.pixels({SIZE[0]}, {SIZE[1]})];
                    pressed = {{ refined: viewer.refined !== null, phase: statuses.at(-1).phase, bytes }};
                }}, {{ once: true }});
            }})()"""
        )
        for kind in ("rawKeyDown", "keyUp"):
            self.page.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code)
        found = self.page.wait("pressed")
        picture = np.array(found.pop("bytes"), np.uint8).reshape(SIZE[1], SIZE[0], 4)
        return {**found, "picture": picture}


@contextlib.contextmanager
def refine_page(pages: Path, data: Path, profile: Path, *, more: Sequence[str] = ()) -> Iterator[RefinePage]:
    """Yield a page of the viewer in `pages` that opens bundles of `data`; `more` are flags of the browser."""
    asked: list[str] = []
    handler = partial(_Handler, pages=pages, data=data, asked=asked)
    with serving(handler) as url, browser(profile, more=more) as page:
        yield RefinePage(page, url, asked)
