"""Pictures of one bundle in Chromium, by our web viewer and by `<model-viewer>`, from cameras of a capture.

Our world is z up. The mesh file turns it to glTF's y up: (x, y, z) becomes (x, z, -y). Directions of an
environment's pixels turn the same way, so that both programs take a map as it is.
Pictures are sRGB-encoded, straight alpha, float64 [height, width, 4].
"""

import base64
import io
import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from lambent_relight.cameras import Camera
from numpy.typing import NDArray
from PIL import Image
from support.chromium import Page, browser
from support.refine_page import build_viewer
from support.view_camera import view_camera

from benchmarks.mirror_ball import ball_glb

Picture = NDArray[np.float64]
TOOL = Path(__file__).parent.parent / "client" / "web" / "tools" / "modelviewer"
SCRIPT = Path("node_modules", "@google", "model-viewer", "dist", "model-viewer.min.js")
BALL = "ball.glb"
INSTALL = f"npm ci --prefix {TOOL.relative_to(Path(__file__).parent.parent)}"
_OURS = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<script type="module" src="lambent-viewer.js"></script>
<style>
  body { margin: 0 }
  lambent-viewer { display: block; width: 256px; height: 256px; min-height: 0 }
</style>
<lambent-viewer></lambent-viewer>"""
_THEIRS = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<style>
  body { margin: 0 }
  model-viewer { display: block; width: WIDTHpx; height: HEIGHTpx; --poster-color: transparent }
</style>
<script type="module" src="model-viewer.js"></script>
<script type="module">
  await customElements.whenDefined("model-viewer");
  // One draws in the size that was asked for, however long it takes.
  customElements.get("model-viewer").minimumRenderScale = 1;
  globalThis.isReady = true;
</script>
<model-viewer loading="eager" interaction-prompt="none" tone-mapping="neutral" exposure="1"
  shadow-intensity="0" min-camera-orbit="-Infinity 0deg 0m" max-camera-orbit="Infinity 180deg 1000m"
  min-field-of-view="1deg" max-field-of-view="120deg"></model-viewer>"""


def orbit_of(camera: Camera) -> dict[str, float]:
    """Return a camera as `<model-viewer>` has it: angles, `radius`, target `x`, `y`, `z`, `fov_deg`.

    `theta` is the azimuth about y from +z towards +x, `phi` the angle from +y, both in radians; `fov_deg` is
    vertical. The target is the point on the axis of view closest to the origin. Raises ValueError for a
    camera that an orbit cannot have: one that is rolled, whose principal point is not in the middle, or that
    looks away.
    """
    pose = np.asarray(camera.camera_to_world)
    right, back, eye = (_y_up(pose[:3, column]) for column in (0, 2, 3))
    if abs(right[1]) > 1e-4:
        raise ValueError(f"{camera.name}: the camera is rolled about its axis of view")
    middle = (camera.width / 2.0, camera.height / 2.0)
    if not np.allclose((camera.centre_x, camera.centre_y), middle) or camera.focal_x != camera.focal_y:
        raise ValueError(f"{camera.name}: the camera does not look through the middle of its picture")
    radius = float(eye @ back)
    if radius <= 0.0:
        raise ValueError(f"{camera.name}: the camera looks away from the origin")
    target = eye - radius * back
    return {
        "theta": float(np.arctan2(back[0], back[2])),
        "phi": float(np.arccos(np.clip(back[1], -1.0, 1.0))),
        "radius": radius,
        **dict(zip("xyz", target.tolist(), strict=True)),
        "fov_deg": float(np.degrees(2.0 * np.arctan(camera.height / (2.0 * camera.focal_y)))),
    }


def _y_up(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vector
    return np.array([x, z, -y])


def rgbe_bytes(radiance: NDArray[np.floating]) -> bytes:
    """Return a Radiance picture, not compressed, of `radiance` [height, width, 3]."""
    height, width, _ = radiance.shape
    _, exponent = np.frexp(radiance.max(axis=-1))
    mantissa = np.clip(np.round(np.ldexp(radiance, 8 - exponent[..., None])), 0, 255)
    pixels = np.concatenate([mantissa, exponent[..., None] + 128], axis=-1).astype(np.uint8)
    pixels[radiance.max(axis=-1) <= 0.0] = 0
    head = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n"
    return head.encode() + pixels.tobytes()


class _Files(SimpleHTTPRequestHandler):
    extensions_map: ClassVar = {**SimpleHTTPRequestHandler.extensions_map, ".js": "text/javascript"}

    def __init__(self, *args: object, folders: dict[str, Path], **kwargs: object) -> None:
        self._folders = folders
        super().__init__(*args, **kwargs)

    def translate_path(self, path: str) -> str:
        first, _, rest = path.partition("?")[0].lstrip("/").partition("/")
        folder = self._folders.get(first)
        return str(folder / rest if folder else self._folders[""] / first / rest)

    def log_message(self, *args: object) -> None:
        """Keep quiet."""


class Side:
    """A page that draws pictures."""

    def __init__(self, page: Page, site: str) -> None:
        self._page, self._site = page, site

    def _open(self, name: str, ready: str) -> None:
        self._page.open(f"{self._site}/{name}")
        self._page.wait(ready, 300.0)


class OurViewer(Side):
    """`<lambent-viewer>`: pictures without ground, background, dither, and exposure of its own."""

    def open(self) -> None:
        """Open the bundle."""
        self._open("ours.html", "document.querySelector('lambent-viewer')?.viewer != null")
        self._page.evaluate(
            """(async () => {
                const element = (globalThis.element = document.querySelector('lambent-viewer'));
                await element.show('bundle/');
                element.viewer.dither = false;
            })()"""
        )

    def light(self, name: str) -> None:
        """Take the light of maps/`name`."""
        self._page.evaluate(
            f"""(async () => {{
                const {{ look }} = element.state;
                await element.update({{
                    environment: 'url:' + new URL('maps/{name}', location.href).href,
                    turn: {{ yawDeg: 0, pitchDeg: 0, rollDeg: 0, intensity: 1 }},
                    look: {{ ...look, tone: 'neutral', exposureEv: 0, autoExposure: false,
                             background: 'transparent', ground: false }},
                }});
            }})()"""
        )

    def picture(self, camera: Camera, *, refined: bool = False) -> Picture:
        """Return what a camera sees."""
        method = "refinedPicture" if refined else "picture"
        text = self._page.evaluate(
            f"""(async () => {{
                const {{ data }} = await element.{method}({json.dumps(view_camera(camera))});
                return btoa(Array.from(data, (byte) => String.fromCharCode(byte)).join(''));
            }})()"""
        )
        shape = (camera.height, camera.width, 4)
        return np.frombuffer(base64.b64decode(text), np.uint8).reshape(shape) / 255.0


class ModelViewer(Side):
    """`<model-viewer>` on the bundle's mesh file: no background, no shadow, exposure 1, the neutral curve."""

    def open(self, model: str = "bundle/mesh/asset.glb") -> None:
        """Open a mesh, that of the bundle, or another file beside the page."""
        self._open("theirs.html", "globalThis.isReady")
        self._page.evaluate(
            f"""new Promise((resolve, reject) => {{
                globalThis.element = document.querySelector('model-viewer');
                element.addEventListener('load', resolve, {{ once: true }});
                element.addEventListener('error', () => reject(new Error('no mesh')), {{ once: true }});
                element.src = {json.dumps(model)};
            }}).then(() => null)"""
        )

    def light(self, name: str) -> None:
        """Take the light of maps/`name`."""
        self._page.evaluate(
            f"""new Promise((resolve, reject) => {{
                element.addEventListener('environment-change', resolve, {{ once: true }});
                element.addEventListener('error', () => reject(new Error('no light')), {{ once: true }});
                element.setAttribute('environment-image', 'maps/{name}');
            }}).then(() => null)"""
        )

    def picture(self, camera: Camera) -> Picture:
        """Return what a camera sees."""
        text = self._page.evaluate(_DRAW.replace("ORBIT", json.dumps(orbit_of(camera))))
        with Image.open(io.BytesIO(base64.b64decode(text.partition(",")[2]))) as image:
            found = np.asarray(image.convert("RGBA"), np.float64) / 255.0
        assert found.shape == (camera.height, camera.width, 4), found.shape
        return found


_DRAW = """(async () => {
    const wanted = ORBIT;
    const frames = async (count) => {
        for (let index = 0; index < count; index++) await new Promise(requestAnimationFrame);
    };
    element.cameraTarget = `${wanted.x}m ${wanted.y}m ${wanted.z}m`;
    element.cameraOrbit = `${wanted.theta}rad ${wanted.phi}rad ${wanted.radius}m`;
    // The element widens a field of view for wide objects: ask for what becomes the wanted one.
    const half = (degrees) => Math.tan((degrees * Math.PI) / 360);
    const widened = Math.max(1, element.getIdealAspect() * element.clientHeight / element.clientWidth);
    const asked = (Math.atan(half(wanted.fov_deg) / widened) * 360) / Math.PI;
    element.fieldOfView = `${asked}deg`;
    await element.updateComplete;
    element.jumpCameraToGoal();
    await frames(3);
    const [orbit, target] = [element.getCameraOrbit(), element.getCameraTarget()];
    const field = element.getFieldOfView();
    const pairs = [
        [orbit.theta, wanted.theta], [orbit.phi, wanted.phi], [orbit.radius, wanted.radius],
        [target.x, wanted.x], [target.y, wanted.y], [target.z, wanted.z], [field, wanted.fov_deg],
    ];
    for (const [is, should] of pairs) {
        if (Math.abs(is - should) > 1e-3) throw new Error(`the camera is ${JSON.stringify(pairs)}`);
    }
    return element.toDataURL('image/png');
})()"""


@contextmanager
def viewers(
    bundle: Path, maps: Path, scratch: Path, size: tuple[int, int], *, theirs: bool
) -> Iterator[tuple[OurViewer, ModelViewer | None]]:
    """Yield both viewers, in a browser of their own each; files of `maps` are their lights.

    Theirs draws in `size`, width and height. `scratch` is a folder for the built pages. Ends the program
    where `<model-viewer>` is wanted and is not installed.
    """
    if theirs and not (TOOL / SCRIPT).is_file():
        raise SystemExit(f"<model-viewer> is not installed: {INSTALL}; or leave it out: --only ours")
    pages = scratch / "pages"
    build_viewer(pages)
    (pages / "ours.html").write_text(_OURS)
    (pages / "theirs.html").write_text(_THEIRS.replace("WIDTH", str(size[0])).replace("HEIGHT", str(size[1])))
    if theirs:
        (pages / BALL).write_bytes(ball_glb())
        shutil.copyfile(TOOL / SCRIPT, pages / "model-viewer.js")
    handler = partial(_Files, folders={"": pages, "bundle": bundle, "maps": maps})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    site = f"http://127.0.0.1:{server.server_address[1]}"
    try:
        with browser(scratch / "profile-ours") as first, browser(scratch / "profile-theirs") as second:
            for page in (first, second):
                page.resize(max(size[0], 300), max(size[1], 300))
            ours = OurViewer(first, site)
            ours.open()
            other = ModelViewer(second, site) if theirs else None
            if other:
                other.open()
            yield ours, other
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def versions() -> dict[str, Any]:
    """Return the version of the browser, and of `<model-viewer>` where it is installed."""
    from support.chromium import program

    told = subprocess.run([str(program()), "--version"], capture_output=True, text=True, check=True).stdout
    package = TOOL / SCRIPT.parent.parent / "package.json"
    theirs = json.loads(package.read_text())["version"] if package.is_file() else None
    return {"browser": told.strip(), "model-viewer": theirs}
