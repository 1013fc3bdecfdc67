"""Compare the brightness of our pictures with Mitsuba's of the same asset, and with photographs.

    python -m benchmarks energy BUNDLE --environments DIR [--scene SCENE] [--views 6] [--spp 256]

Every row is a light and a region of the pictures: everything the object covers, what is open to the sky
(more than 0.8 of the cosine-weighted hemisphere) and contacts (less than 0.4). A figure is the sum of linear
radiance over the region, our picture's over Mitsuba's: 1 means that nothing is lost. *Direct diffuse* is
the diffuse lobe alone, without bounces, against a Lambertian material in Mitsuba: shadows and nothing else.
The last column is Mitsuba's own sum over that of the scene's true pictures, where there are any.
"""

import argparse
import re
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.colour import linear_from_srgb
from lambent_relight import Bundle, Camera, Renderer, load_bundle, load_environment
from lambent_relight.asset.write import write_formats
from numpy.typing import NDArray
from PIL import Image

QUICK = "{bundle} --environments {maps} --views 1 --spp 4 --side 16"

_OPEN, _CONTACT = 0.8, 0.4
_MATT = """<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
  <string name="filename" value="diffuse.exr"/><boolean name="raw" value="true"/>
  <string name="wrap_mode" value="clamp"/></texture></bsdf>"""


def mitsuba_pictures(mi: Any, scene: Path, count: int, spp: int, *, matt: bool) -> list[NDArray[np.float64]]:
    """Return Mitsuba's pictures of the first `count` cameras of an exported scene, RGBA; `matt` as above."""
    text = scene.read_text(encoding="utf-8")
    if matt:
        text = re.sub(r'<bsdf type="principled">.*?</bsdf>', _MATT, text, flags=re.DOTALL)
        text = text.replace(
            '<integrator type="path">', '<integrator type="path"><integer name="max_depth" value="2"/>'
        )
        scene = scene.with_name("matt.xml")
        scene.write_text(text, encoding="utf-8")
    loaded = mi.load_file(str(scene), spp=spp)
    return [np.array(mi.render(loaded, sensor=number, seed=number), np.float64) for number in range(count)]


def write_diffuse(mi: Any, folder: Path) -> None:
    """Write the diffuse albedo of an exported scene, linear, to diffuse.exr."""
    colour = linear_from_srgb(np.asarray(Image.open(folder / "base_colour.png").convert("RGB")) / 255.0)
    metalness = np.asarray(Image.open(folder / "metalness.png").convert("L")) / 255.0
    mi.Bitmap((colour * (1.0 - metalness[..., None])).astype(np.float32)).write(str(folder / "diffuse.exr"))


def truth(folder: Path, camera: Camera, light: str) -> NDArray[np.float64] | None:
    """Return the true picture of a camera, premultiplied linear radiance, or None where there is none."""
    for name in (f"rgba_{light}.png", f"rgba_{light}_000.png"):
        path = folder / camera.name / name
        if path.is_file():
            rgba = np.asarray(Image.open(path).resize((camera.width, camera.height), Image.BOX)) / 255.0
            return linear_from_srgb(rgba[..., :3]) * rgba[..., 3:]
    return None


def compared(
    bundle: Bundle, cameras: list[Camera], path: Path, arguments: argparse.Namespace, mi: Any
) -> list[list[float]]:
    """Return a row per region: ratios of matt, refined and baked pictures to Mitsuba's, and its to truth."""
    light = load_environment(path)
    with tempfile.TemporaryDirectory() as name:
        bundle_with = bundle_seen_by(bundle, cameras)
        (scene,) = write_formats(bundle_with, Path(name), ["mitsuba"], environment=light)
        write_diffuse(mi, scene.parent)
        whole = mitsuba_pictures(mi, scene, len(cameras), arguments.spp, matt=False)
        matt = mitsuba_pictures(mi, scene, len(cameras), arguments.spp, matt=True)
    renderer = Renderer(bundle, num_threads=arguments.threads)
    ways: list[Callable[[Camera], NDArray[np.floating]]] = []
    for occlusion in ("cache", "mesh"):
        way = {"occlusion": occlusion, "spp": arguments.spp, "antialias": 2}
        ways.append(lambda c, w=way: renderer.render(c, light, indirect=False, **w).diffuse)
        ways.append(lambda c, w=way: renderer.render(c, light, **w).rgb)
    ways.append(lambda c: renderer.render(c, light, quality="baked", antialias=2).rgb)
    sums = np.zeros((3, len(ways) + 3))
    for number, camera in enumerate(cameras):
        seen = renderer.render(camera, light, spp=64, occlusion="mesh")
        inside = (seen.coverage[..., 0] > 0.99) & (whole[number][..., 3] > 0.99)
        openness = seen.visibility[..., 0]
        pictures = [way(camera) for way in ways]
        true = truth(arguments.scene, camera, path.stem) if arguments.scene else None
        pictures += [matt[number][..., :3], whole[number][..., :3], np.zeros(1) if true is None else true]
        for row, region in enumerate((inside, inside & (openness > _OPEN), inside & (openness < _CONTACT))):
            sums[row] += [
                float(picture[region].sum()) if picture.ndim == 3 else np.nan for picture in pictures
            ]
    ours, matt_sum, whole_sum, true_sum = sums[:, :-3], sums[:, -3], sums[:, -2], sums[:, -1]
    reference = [matt_sum, whole_sum, matt_sum, whole_sum, whole_sum]
    ratios = [ours[:, k] / reference[k] for k in range(len(ways))]
    return np.stack([*ratios, whole_sum / true_sum], axis=1).tolist()


def bundle_seen_by(bundle: Bundle, cameras: list[Camera]) -> Bundle:
    """Return `bundle` with `cameras` in place of its own."""

    class Seen(type(bundle)):  # type: ignore[misc]
        def cameras(self) -> list[Camera]:
            """Return the cameras of the comparison."""
            return cameras

    return Seen(path=bundle.path, manifest=bundle.manifest, source=bundle.source)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("bundle", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--scene", type=Path, help="folder of the captured scene, for its true pictures")
    parser.add_argument("--views", type=int, default=6)
    parser.add_argument("--spp", type=int, default=256)
    parser.add_argument("--side", type=int, default=96)
    parser.add_argument("--threads", type=int, default=1)


def main(arguments: argparse.Namespace) -> None:
    """Measure and print the table of docs/benchmarks/asset.md, "Energy"."""
    import mitsuba as mi

    mi.set_variant("scalar_rgb")
    bundle = load_bundle(arguments.bundle)
    cameras = [camera.resized(arguments.side, arguments.side) for camera in bundle.cameras()]
    cameras = cameras[: arguments.views]
    print("| light, region | direct diffuse: cache | mesh | refined: cache | mesh | baked | Mitsuba / true |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for path in sorted(arguments.environments.glob("*.hdr")):
        rows = compared(bundle, cameras, path, arguments, mi)
        for region, (c0, c1, m0, m1, b, t) in zip(("all", "open", "contacts"), rows, strict=True):
            name = f"{path.stem}, {region}"
            print(f"| {name} | {c0:.3f} | {m0:.3f} | {c1:.3f} | {m1:.3f} | {b:.3f} | {t:.3f} |")
