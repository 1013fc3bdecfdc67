"""Compare estimated cameras with true ones: path-traced photographs of a textured scene, solved by COLMAP.

    python -m benchmarks poses [--views 24] [--side 384] [--spp 8] [--repeats 1] [--keep] [-o DIR]

Renders a box, a ball and a cylinder, all textured, on a textured plate with Mitsuba (extra `dev`), finds the
cameras, and compares them with the true ones up to a similarity. The plate stands on a
textured floor, which masks leave out.
"""

import argparse
import json
import shutil
import time
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.poses.capture import solve_capture
from lambent_capture.poses.solve import PoseSettings
from numpy import ndarray
from PIL import Image
from scipy import ndimage

from benchmarks.pose_errors import pose_errors

QUICK = "--views 16 --side 256 --spp 4"

DISTANCE = 4.0
FIELD_DEG = 40.0


def spots(seed: int, side: int = 512) -> ndarray:
    """Return a texture [side, side, 3] of soft spots in three sizes, linear."""
    noise = np.random.default_rng(seed).normal(size=(side, side, 3))
    grey = noise.mean(axis=-1, keepdims=True) * 1.7
    mixed = sum(ndimage.gaussian_filter(0.4 * noise + grey, (s, s, 0), mode="wrap") * s for s in (1.5, 4, 10))
    return np.clip(0.4 + 0.25 * mixed, 0.02, 0.9).astype(np.float32)


def matter(seed: int, scale: float, alpha: float) -> dict:
    """Return a glossy plastic with a texture, `scale` repeats."""
    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(spots(seed)),
        "raw": True,
        "to_uv": mi.ScalarTransform4f().scale([scale, scale, 1.0]),
    }
    return {"type": "roughplastic", "diffuse_reflectance": texture, "alpha": alpha}


def scene(repeats: float, *, whole: bool) -> Any:
    """Return the scene: objects 1 unit large around the origin, z up, under a bright sky and a lamp.

    `repeats` is how often the floor's pattern is repeated. Without `whole` there is nothing but the object,
    for masks: no floor, and alpha 0 where nothing is hit.
    """
    at = mi.ScalarTransform4f()
    floor = {
        "type": "rectangle",
        "to_world": at.translate([0.0, 0.0, -0.52]).scale(5.0),
        "bsdf": {"type": "twosided", "nested": matter(4, repeats, 0.4)},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3 if whole else 2, "hide_emitters": not whole},
            **({"floor": floor} if whole else {}),
            "sky": {"type": "constant", "radiance": 0.7},
            "lamp": {
                "type": "sphere",
                "center": [3.0, 2.0, 4.0],
                "radius": 0.6,
                "emitter": {"type": "area", "radiance": 12.0},
            },
            "plate": {
                "type": "disk",
                "to_world": at.translate([0.0, 0.0, -0.5]).scale(1.3),
                "bsdf": {"type": "twosided", "nested": matter(0, 1.0, 0.3)},
            },
            "box": {
                "type": "cube",
                "to_world": at.translate([-0.4, 0.1, -0.15]).rotate([0, 0, 1], 25.0).scale(0.35),
                "bsdf": matter(1, 1.0, 0.2),
            },
            "ball": {
                "type": "sphere",
                "to_world": at.translate([0.45, -0.25, -0.12]).scale(0.38),
                "bsdf": matter(2, 2.0, 0.15),
            },
            "post": {
                "type": "cylinder",
                "to_world": at.translate([0.3, 0.55, -0.5]).scale([0.22, 0.22, 1.0]),
                "bsdf": {"type": "twosided", "nested": matter(3, 1.5, 0.25)},
            },
        }
    )


def true_pose(number: int, views: int) -> ndarray:
    """Return camera-to-world, axes x right, y up, looking along -z: two rings, 25 and 50 degrees up."""
    azimuth = 2.0 * np.pi * number / views
    elevation = np.radians(25.0 if number % 2 == 0 else 50.0)
    back = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    pose[:3, 3] = DISTANCE * back
    return pose


def render(out: Path, views: int, side: int, spp: int, repeats: float) -> dict[str, ndarray]:
    """Write `photographs/` and `cut/` (masks); return the true poses by name."""
    world, alone = scene(repeats, whole=True), scene(repeats, whole=False)
    poses = {}
    for number in range(views):
        pose = true_pose(number, views)
        # Mitsuba's cameras look along +z with x to the left.
        turned = pose @ np.diag([-1.0, 1.0, -1.0, 1.0])
        sensor = mi.load_dict(
            {
                "type": "perspective",
                "fov": FIELD_DEG,
                "to_world": mi.ScalarTransform4f(turned),
                "film": {"type": "hdrfilm", "width": side, "height": side, "pixel_format": "rgba"},
                "sampler": {"type": "independent", "sample_count": spp},
            }
        )
        light = np.array(mi.render(world, sensor=sensor, seed=number, spp=spp))[..., :3]
        alpha = np.array(mi.render(alone, sensor=sensor, seed=number, spp=2))[..., 3]
        name = f"{number:03d}"
        for folder, pixels in (("photographs", light), ("cut", np.round(alpha))):
            (out / folder).mkdir(parents=True, exist_ok=True)
            encoded = mi.Bitmap(np.ascontiguousarray(pixels, dtype=np.float32))
            kind, gamma = mi.Struct.Type.UInt8, folder == "photographs"
            plain = np.array(encoded.convert(component_format=kind, srgb_gamma=gamma)).squeeze()
            Image.fromarray(plain).save(out / folder / f"{name}.png")
        poses[f"{name}.png"] = pose
    return poses


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--side", type=int, default=384)
    parser.add_argument("--spp", type=int, default=8)
    parser.add_argument("--repeats", type=float, default=1.0, help="of the floor's pattern")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", action="store_true", help="use the photographs of an earlier call")


def main(options: argparse.Namespace) -> dict[str, dict]:
    """Render, solve, compare, print, and write `poses.json`."""
    mi.set_variant("scalar_rgb")
    if options.keep:
        true = {f"{i:03d}.png": true_pose(i, options.views) for i in range(options.views)}
    else:
        true = render(options.out, options.views, options.side, options.spp, options.repeats)
    rows = {}
    for name, masks in (("whole pictures", None), ("inside masks", options.out / "cut")):
        target = options.out / name.replace(" ", "_")
        shutil.rmtree(target, ignore_errors=True)
        began = time.process_time()
        settings = PoseSettings(seed=options.seed)
        record = solve_capture(options.out / "photographs", target, masks, settings)
        seconds = time.process_time() - began
        manifest = describe_scene(target)
        frames = {frame.images[0].path.removeprefix("images/"): frame for frame in manifest.frames}
        common = [key for key in true if key in frames]
        estimated = np.array([np.array(frames[key].camera.camera_to_world).reshape(4, 4) for key in common])
        rotation, centre = pose_errors(estimated, np.array([true[key] for key in common]))
        focal = 0.5 * options.side / np.tan(np.radians(0.5 * FIELD_DEG))
        rows[name] = {
            "registered": record["registered"],
            "photographs": record["photographs"],
            "reprojection_error_px": record["reprojection_error_px"],
            "rotation_deg": [float(rotation.mean()), float(rotation.std()), float(rotation.max())],
            "centre_share": [float(centre.mean()), float(centre.std()), float(centre.max())],
            "focal_ratio": manifest.frames[0].camera.focal_x / focal,
            "seconds": seconds,
        }
        print(name, json.dumps(rows[name]), flush=True)
    return rows
