"""Python fixtures of the web viewer's browser tests: a bundle, maps, and the expected pictures.

Run as a program with a folder; writes there
    bundle/, bundle.relight.zip, spots.exr, sunset.hdr, expected.json, golden/, golden.exr, golden.json
expected.json lists pictures: map, rotation, camera, material edit, and a file of RGBA bytes of `baked`.
"""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from pathlib import Path

import numpy as np
from google.protobuf import json_format
from lambent_core.colour import srgb_from_linear
from lambent_core.directions import pixel_directions
from lambent_proto.v1.bundle_pb2 import BundleManifest
from lambent_relight import load_bundle, load_environment
from lambent_relight.cameras import turntable
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.maps import write_environment
from lambent_relight.images import encode_png
from lambent_relight.renderer import Renderer
from PIL import Image
from support.analytic_bundle import write_manifest
from support.analytic_scene import AnalyticScene, Box, Surface
from support.baked_bundle import write_baked_bundle
from support.golden_light import golden_light
from support.view_camera import view_camera

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "bundles"
SIDE = 256
SCENE = AnalyticScene(
    (
        Box((-1.0, -1.0, -0.6), (1.0, 1.0, -0.4), Surface(albedo=(0.6, 0.6, 0.6), perceptual_roughness=0.7)),
        Box((-0.7, -0.5, -0.4), (0.0, 0.3, 0.5), Surface(albedo=(0.8, 0.3, 0.2), perceptual_roughness=0.5)),
        Box(
            (0.3, -0.3, -0.4),
            (0.8, 0.6, 0.1),
            Surface(albedo=(0.95, 0.75, 0.35), perceptual_roughness=0.3, metalness=1.0),
        ),
    )
)
SUNSET = Path(__file__).resolve().parents[2] / "client/python/lambent/sample/envmaps/sunset.hdr"
CASES = (
    ("spots.exr", 0.0, 0, MaterialEdit()),
    ("spots.exr", 90.0, 0, MaterialEdit()),
    ("spots.exr", -37.0, 1, MaterialEdit()),
    ("sunset.hdr", 0.0, 2, MaterialEdit()),
    ("spots.exr", 0.0, 0, MaterialEdit(albedo_gain=(1.5, 0.5, 0.8), roughness_scale=1.6)),
)


def spots(height: int = 64) -> np.ndarray:
    """Return a map that has no symmetry: a sun, a blue wall, a red floor corner."""
    direction = pixel_directions(height, 2 * height)
    x, y, z = np.moveaxis(direction, -1, 0)
    image = np.stack([0.25 + 0.1 * z, 0.3 + 0.1 * z, 0.4 + 0.2 * z], axis=-1)
    image[(y > 0.6)] += (0.1, 0.3, 1.2)
    image[(z < -0.3) & (x < 0.0)] += (0.8, 0.1, 0.0)
    sun = np.array([0.55, -0.35, 0.75]) / np.linalg.norm([0.55, -0.35, 0.75])
    image[direction @ sun > np.cos(np.radians(4.0))] += (90.0, 80.0, 60.0)
    return image.astype(np.float32)


def write_fixture(folder: Path) -> None:
    """Write everything into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = turntable(3, radius=4.5, elevation_deg=30.0, width=SIDE, height=SIDE, start_deg=25.0)
    bundle = write_baked_bundle(folder / "bundle", SCENE, side=40, cameras=cameras)
    write_environment(folder / "spots.exr", spots())
    (folder / "sunset.hdr").write_bytes(SUNSET.read_bytes())
    renderer = Renderer(load_bundle(bundle))
    pictures = []
    for number, (name, rotate_deg, view, edit) in enumerate(CASES):
        picture = renderer.render(
            cameras[view],
            load_environment(folder / name),
            quality="baked",
            soft_edges=False,
            rotate_deg=rotate_deg,
            antialias=2,
            edit=edit,
        )
        pixels = encode_png(picture)
        alpha = np.round(255.0 * np.clip(picture.opacity, 0.0, 1.0)).astype(np.uint8)
        (folder / f"picture_{number}.rgba").write_bytes(
            np.concatenate([pixels[..., :3], alpha], axis=-1).tobytes()
        )
        pictures.append(
            {
                "file": f"picture_{number}.rgba",
                "map": name,
                "rotateDeg": rotate_deg,
                "camera": view_camera(cameras[view]),
                "albedoGain": edit.albedo_gain,
                "roughnessScale": edit.roughness_scale,
            }
        )
    _add_photograph(bundle, cameras[0].name, folder / "picture_0.rgba")
    with zipfile.ZipFile(folder / "bundle.relight.zip", "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(p for p in bundle.rglob("*") if p.is_file()):
            archive.write(path, path.relative_to(bundle).as_posix())
    (folder / "expected.json").write_text(json.dumps(pictures), encoding="utf-8")
    _write_golden(folder)


def _write_golden(folder: Path) -> None:
    """Copy the golden bundles, their light, and the pictures that were stored with them.

    golden.json names, for each, the file, its camera, and RGBA bytes of the `baked` picture.
    """
    (folder / "golden").mkdir()
    write_environment(folder / "golden.exr", golden_light().radiance, half=False)
    listed = []
    for path in sorted(GOLDEN.glob("*.json")):
        stored = json.loads(path.read_text())
        name = path.name.removesuffix(".json")
        shutil.copy(path.with_name(f"{name}.relight.zip"), folder / "golden")
        opacity = np.array(stored["opacity"]["baked"])[..., None]
        straight = np.array(stored["rgb"]["baked"]) / np.maximum(opacity, 1e-3)
        values = np.concatenate([srgb_from_linear(np.clip(straight, 0.0, 1.0)), opacity], axis=-1)
        (folder / "golden" / f"{name}.rgba").write_bytes(np.round(255.0 * values).astype(np.uint8).tobytes())
        (camera,) = load_bundle(folder / "golden" / f"{name}.relight.zip").cameras()
        listed.append(
            {
                "bundle": f"golden/{name}.relight.zip",
                "picture": f"golden/{name}.rgba",
                "camera": view_camera(camera),
            }
        )
    (folder / "golden.json").write_text(json.dumps(listed), encoding="utf-8")


def _add_photograph(bundle: Path, name: str, picture: Path) -> None:
    """Put a picture into a bundle as if it were the photograph of a camera."""
    (bundle / "preview").mkdir()
    image = Image.frombytes("RGBA", (SIDE, SIDE), picture.read_bytes())
    image.convert("RGB").save(bundle / "preview" / f"photo_{name}.png")
    manifest = json_format.Parse((bundle / "manifest.json").read_text(), BundleManifest())
    write_manifest(bundle, manifest)


if __name__ == "__main__":
    write_fixture(Path(sys.argv[1]))
