"""Render the scene that ships with Lambent, or another one of ours: path traced, with its ground truth.

    python examples/make_sample_scene.py -o FOLDER [--scene NAME] [--spp N] [--only test_000]

Needs Mitsuba 3 (in the `dev` extra) and an LLVM library (Debian: `apt-get install libllvm19`). Writes a
folder in TensoIR-synthetic's layout; its conventions are written to scene.json. Before anything is rendered,
one-pixel environments are checked to shine from where the convention puts them; each view's coverage
is compared with that of rays cast by the documented pixel convention.
"""

import argparse
import glob
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from sample_environments import directions, lookup

if TYPE_CHECKING:
    import mitsuba as mi
    from sample_scenes.catalogue import Scene

DEFAULT_SCENE = "breakfast"
MAX_DEPTH = 8
CAMERA_ANGLE_X, CAMERA_DISTANCE = 0.628318530717959, 4.0

CONVENTIONS = {
    "world": "right-handed, z up; object inside a sphere of radius 1.3 at the origin; cameras at distance 4",
    "cam_transform_mat": (
        "camera-to-world, row-major, comma separated; camera x right, y up, looks along -z (Blender)"
    ),
    "pixel": (
        "ray of pixel (row r, col c): ((c+.5-W/2)/f, -(r+.5-H/2)/f, -1) in camera axes, "
        "f = W/2/tan(cam_angle_x/2); a value is the mean over the pixel square"
    ),
    "rgba_*": "sRGB-encoded (piecewise curve), straight alpha, 8-bit; linear radiance clipped to [0,1] first",
    "albedo.png": "LINEAR base colour, 8-bit, straight alpha (for metal: reflectance at normal incidence)",
    "roughness/metallic": (
        "linear; GGX alpha = roughness^2; dielectric F0 = 0.04; Mitsuba 'principled' BSDF"
    ),
    "normal.png": "world-space shading normal facing the camera, n*0.5+0.5, straight alpha = coverage",
    "distance.exr": "half float, mean Euclidean distance from the camera over hit samples, 0 on background",
    "env": (
        "pixel (r,c) of HxW looks along az = pi - 2pi(c+.5)/W, el = pi/2 - pi(r+.5)/H, "
        "d = (cos az cos el, sin az cos el, sin el); linear radiance, bilinear between pixel centres"
    ),
    "rotation": "rgba_<env>_<deg>.png: environment turned by +deg about +z, L_deg(d) = L_0(Rz(-deg) d)",
}


def cameras(what: "Scene") -> dict[str, np.ndarray]:
    """Return camera-to-world [4, 4] by view name: spirals over the upper hemisphere, test between train."""

    def spiral(count: int, phase: float) -> list[np.ndarray]:
        golden = np.pi * (3.0 - np.sqrt(5.0))
        height = what.lowest + (0.92 - what.lowest) * (np.arange(count) + 0.5) / count
        return [look_from(z, golden * k + phase, what.aim) for k, z in enumerate(height)]

    named = {f"train_{k:03d}": pose for k, pose in enumerate(spiral(what.num_train, 0.0))}
    return named | {f"test_{k:03d}": pose for k, pose in enumerate(spiral(what.num_test, 1.0))}


def look_from(height: float, azimuth: float, aim: float) -> np.ndarray:
    """Return the camera-to-world matrix of a camera that looks at the height `aim` on the axis."""
    flat = np.sqrt(1.0 - height**2)
    target = np.array([0.0, 0.0, aim])
    eye = CAMERA_DISTANCE * np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return pose


def focal_length(resolution: int) -> float:
    """Return the focal length in pixels."""
    return 0.5 * resolution / np.tan(0.5 * CAMERA_ANGLE_X)


def llvm_library() -> str | None:
    """Return the LLVM library for Dr.Jit: the configured one, or Debian's newest from version 16 on.

    With version 15, which some graphics drivers install, differentiating a picture crashed the process.
    """
    libraries = sorted(glob.glob("/usr/lib/*/libLLVM-1[6-9].so") + glob.glob("/usr/lib/*/libLLVM-2?.so"))
    return os.environ.get("DRJIT_LIBLLVM_PATH") or (libraries[-1] if libraries else None)


def load_renderer() -> None:
    """Select Mitsuba's vectorised variant; ends the program where there is no LLVM."""
    library = llvm_library()
    if library is None:
        raise SystemExit("no LLVM library found; apt-get install libllvm19, or set DRJIT_LIBLLVM_PATH to one")
    os.environ["DRJIT_LIBLLVM_PATH"] = library
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")


def emitter(image: np.ndarray, rows: int | None = None) -> dict:
    """Return Mitsuba's environment for `image` [H, W, 3], resampled to an odd number of `rows`.

    By default those are at least 513, and four for each of the image's.

    Mitsuba's rows lie at pi r / (H - 1) and its up is y, so the picture is resampled to rows of its own and
    turned; columns agree. `check_environment` holds the result against the convention.
    """
    import mitsuba as mi

    height = rows or max(513, 4 * len(image) + 1)
    width = 2 * (height - 1)
    azimuth = np.pi - 2.0 * np.pi * (np.arange(width) + 0.5) / width
    elevation = np.pi / 2.0 - np.pi * np.arange(height) / (height - 1)
    azimuth, elevation = np.meshgrid(azimuth, elevation)
    flat = np.cos(elevation)
    direction = np.stack([np.cos(azimuth) * flat, np.sin(azimuth) * flat, np.sin(elevation)], axis=-1)
    turn = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float)
    picture = mi.Bitmap(lookup(image, direction).astype(np.float32))
    return {"type": "envmap", "bitmap": picture, "to_world": mi.ScalarTransform4f(turn)}


def build(shapes: dict[str, Any], image: np.ndarray) -> "mi.Scene":
    """Return `shapes` lit by the environment `image`."""
    import mitsuba as mi

    return mi.load_dict({"type": "scene", "light": emitter(image), **shapes})


def render(scene: "mi.Scene", pose: np.ndarray, resolution: int, spp: int, seed: int) -> np.ndarray:
    """Return linear radiance with straight alpha, float32 [resolution, resolution, 4]."""
    import mitsuba as mi

    sensor = mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(CAMERA_ANGLE_X)),
            "fov_axis": "x",
            "near_clip": 0.1,
            # Mitsuba's camera looks along +z with x to the left: half a turn about y.
            "to_world": mi.ScalarTransform4f(pose @ np.diag([-1.0, 1.0, -1.0, 1.0])),
            "sampler": {"type": "independent", "sample_count": spp},
            "film": {
                "type": "hdrfilm",
                "width": resolution,
                "height": resolution,
                "pixel_format": "rgba",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
        }
    )
    integrator = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "hide_emitters": True})
    premultiplied = np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed))
    if not np.isfinite(premultiplied).all():
        raise SystemExit("a picture has values that are not numbers; look for triangles without height")
    return straight(premultiplied[..., :3], premultiplied[..., 3])


def straight(total: np.ndarray, coverage: np.ndarray) -> np.ndarray:
    """Return [..., c + 1]: `total` divided by `coverage` where there is any, and the coverage."""
    value = np.divide(total, coverage[..., None], out=np.zeros_like(total), where=coverage[..., None] > 0)
    return np.concatenate([value, coverage[..., None]], axis=-1).astype(np.float32)


def truth(
    scene: "mi.Scene", what: "Scene", pose: np.ndarray, resolution: int, spp: int
) -> dict[str, np.ndarray]:
    """Return albedo, normal (straight alpha), roughness, metallic, distance and material, with our own rays.

    The rays follow the documented pixel convention and nothing of Mitsuba's camera. `material` is 0 where
    every ray of a pixel misses, the number of a uniform material where every ray hits it, else 255.
    """
    import mitsuba as mi

    side = int(np.sqrt(spp))
    offset = (np.arange(resolution * side) + 0.5) / side - resolution / 2.0
    x, y = np.meshgrid(offset, offset)
    focal = focal_length(resolution)
    local = np.stack([x / focal, -y / focal, -np.ones_like(x)], axis=-1).reshape(-1, 3)
    world = local @ pose[:3, :3].T
    world /= np.linalg.norm(world, axis=-1, keepdims=True)
    eye = np.broadcast_to(pose[:3, 3], world.shape)
    ray = mi.Ray3f(mi.Point3f(eye.T.astype(np.float32)), mi.Vector3f(world.T.astype(np.float32)))
    hit = scene.ray_intersect(ray)
    bsdf, valid = hit.bsdf(ray), hit.is_valid()
    normal = np.array(hit.sh_frame.n).T
    normal *= -np.sign((normal * world).sum(axis=-1, keepdims=True))
    values = {
        "albedo": np.array(bsdf.eval_attribute_3("base_color", hit, valid)).T,
        "normal": normal,
        "roughness": np.array(bsdf.eval_attribute_1("roughness", hit, valid))[:, None],
        "metallic": np.array(bsdf.eval_attribute_1("metallic", hit, valid))[:, None],
        "distance": np.array(hit.t)[:, None],
    }
    mask = np.array(valid)[:, None]
    label = np.where(mask, 255, 0)
    found_triple = np.concatenate([values["albedo"], values["roughness"], values["metallic"]], axis=-1)
    for number, surface in what.uniform_surfaces.items():
        triple = np.array([*surface.base_colour, surface.perceptual_roughness, surface.metallic])
        label[mask[:, 0] & (np.abs(found_triple - triple) < 1e-5).all(axis=-1)] = number

    def pixels(per_ray: np.ndarray) -> np.ndarray:
        grid = per_ray.reshape(resolution, side, resolution, side, -1)
        return grid.mean(axis=(1, 3))

    coverage = pixels(mask.astype(np.float64))[..., 0]
    maps = {k: straight(pixels(np.where(mask, v, 0.0)), coverage) for k, v in values.items()}
    length = np.linalg.norm(maps["normal"][..., :3], axis=-1, keepdims=True)
    maps["normal"][..., :3] /= np.where(length > 0, length, 1.0)
    first = (
        label.reshape(resolution, side, resolution, side)
        .transpose(0, 2, 1, 3)
        .reshape(resolution, resolution, -1)
    )
    maps["material"] = np.where((first == first[..., :1]).all(axis=-1), first[..., 0], 255)
    return maps


def check_environment(tolerance_pixels: float = 0.25) -> None:
    """Raise unless a one-pixel environment lights Mitsuba's scene from the direction the convention says."""
    import mitsuba as mi

    height, width = 64, 128
    generator = np.random.default_rng(0)
    probe = generator.normal(size=(400_000, 3))
    probe /= np.linalg.norm(probe, axis=-1, keepdims=True)
    for row, column in [(10, 20), (32, 64), (50, 100), (20, 3), (45, 127)]:
        image = np.zeros((height, width, 3), np.float32)
        image[row, column] = 1.0
        scene = mi.load_dict({"type": "scene", "light": emitter(image)})
        ray = mi.Ray3f(mi.Point3f(0, 0, 0), mi.Vector3f(probe.T.astype(np.float32)))
        seen = np.array(scene.environment().eval(scene.ray_intersect(ray)))[0]
        middle = (probe * seen[:, None]).sum(axis=0)
        angle = np.arccos(
            np.clip(middle @ directions(height, width)[row, column] / np.linalg.norm(middle), -1, 1)
        )
        if angle > tolerance_pixels * np.pi / height:
            raise SystemExit(
                f"environment pixel {(row, column)} shines from {np.degrees(angle):.2f} deg away"
            )


def write_png(path: Path, image: np.ndarray) -> None:
    """Write values in [0, 1] as an 8-bit PNG."""
    from PIL import Image

    levels = (np.clip(image, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    Image.fromarray(levels[..., 0] if levels.shape[-1] == 1 else levels).save(path, optimize=True)


def encode_srgb(linear: np.ndarray) -> np.ndarray:
    """Return sRGB-encoded values of `linear` clipped to [0, 1]."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)


def write_view(
    folder: Path,
    what: "Scene",
    pose: np.ndarray,
    scenes: dict[str, "mi.Scene"],
    spp: int,
    seed: int,
    radiance: bool = False,
) -> None:
    """Render one view under every scene of `scenes` (picture name -> lit scene) and write its folder.

    With `radiance`, linear pictures that are not clipped are written as well.
    """
    import mitsuba as mi

    folder.mkdir(parents=True, exist_ok=True)
    first = next(iter(scenes.values()))
    for name, scene in scenes.items():
        picture = render(scene, pose, what.resolution, spp, seed)
        write_png(folder / f"rgba_{name}.png", np.dstack([encode_srgb(picture[..., :3]), picture[..., 3]]))
        if radiance:
            mi.Bitmap(picture.astype(np.float16)).write(str(folder / f"radiance_{name}.exr"))
    maps = truth(first, what, pose, what.resolution, what.truth_spp)
    disagreement = np.abs(maps["albedo"][..., 3] - picture[..., 3]).mean()
    if disagreement > 0.005:
        raise SystemExit(
            f"{folder.name}: coverage by our rays and by Mitsuba's camera differs by {disagreement:.4f}"
        )
    test = folder.name.startswith("test")
    if test or what.training_maps:
        write_png(folder / "albedo.png", maps["albedo"])
        normal = maps["normal"]
        write_png(folder / "normal.png", np.dstack([normal[..., :3] * 0.5 + 0.5, normal[..., 3]]))
    if test:
        write_png(folder / "roughness.png", maps["roughness"][..., :1])
        write_png(folder / "metallic.png", maps["metallic"][..., :1])
        distance = mi.Bitmap(maps["distance"][..., 0].astype(np.float16))
        distance.write(str(folder / "distance.exr"))
        write_png(folder / "material.png", maps["material"][..., None] / 255.0)
    matrix = ",".join(f"{value:.9g}" for value in pose.ravel())
    metadata = {
        "scene": what.name,
        "imw": what.resolution,
        "imh": what.resolution,
        "cam_angle_x": CAMERA_ANGLE_X,
        "spp": spp,
        "cam_transform_mat": matrix,
    }
    (folder / "metadata.json").write_text(json.dumps(metadata, indent=1) + "\n", encoding="utf-8")


def write_environment(path: Path, image: np.ndarray) -> np.ndarray:
    """Write `image` as Radiance .hdr and return what a reader gets back, which is what is rendered with."""
    import mitsuba as mi

    path.parent.mkdir(parents=True, exist_ok=True)
    mi.Bitmap(image).write(str(path))
    return np.array(mi.Bitmap(str(path)).convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, False))


def description(what: "Scene", spp: int | None, environment: np.ndarray) -> dict:
    """Return the content of scene.json; `spp` in place of the scene's own."""
    import mitsuba as mi

    size = environment.shape
    return {
        "suite": "sample",
        "scene": what.name,
        "about": what.about,
        "resolution": what.resolution,
        "train_env": what.train_light,
        "rotations": ["000"],
        "test_envs": list(what.unseen_lights),
        "views": {"train": what.num_train, "test": what.num_test},
        "spp": {"train": spp or what.spp_train, "test": spp or what.spp_test},
        "max_depth": MAX_DEPTH,
        "renderer": f"Mitsuba {mi.__version__} path integrator, {mi.variant()}",
        "env_processing": (
            f"procedural, {size[1]}x{size[0]}, scaled to mean 0.42, rendered from the stored RGBE values"
        ),
        "near_far": [2.0, 6.0],
        "bbox": [[-1.3, -1.3, -1.3], [1.3, 1.3, 1.3]],
        "sources": {
            "everything": "generated by examples/make_sample_scene.py; Apache-2.0 like the rest of Lambent"
        },
        "conventions": CONVENTIONS | what.conventions,
    }


def main(arguments: list[str] | None = None) -> None:
    """Render a scene, or one view of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--scene", default=DEFAULT_SCENE, help="its name in sample_scenes/catalogue.py")
    parser.add_argument("--spp", type=int, help="samples per pixel, in place of the scene's own")
    parser.add_argument("--only", help="render the views whose names begin so, e.g. test_000 or test")
    parser.add_argument(
        "--radiance", action="store_true", help="also write radiance_<light>.exr: not clipped"
    )
    options = parser.parse_args(arguments)
    load_renderer()
    from sample_scenes.catalogue import SCENES

    if options.scene not in SCENES:
        parser.error(f"no scene {options.scene!r}; there are {', '.join(SCENES)}")
    what = SCENES[options.scene]
    check_environment()
    stored = {
        name: write_environment(options.output / "envmaps" / f"{name}.hdr", what.light(name))
        for name in what.lights
    }
    text = json.dumps(description(what, options.spp, stored[what.train_light]), indent=1)
    (options.output / "scene.json").write_text(text + "\n", encoding="utf-8")
    views = {
        name: (seed, pose)
        for seed, (name, pose) in enumerate(cameras(what).items())
        if name.startswith(options.only or "")
    }
    shapes = what.objects()
    lit = {f"{what.train_light}_000": build(shapes, stored[what.train_light])}
    if any(name.startswith("test") for name in views):
        all_lit = lit | {name: build(shapes, stored[name]) for name in what.unseen_lights}
    for name, (seed, pose) in views.items():
        test = name.startswith("test")
        spp = options.spp or (what.spp_test if test else what.spp_train)
        write_view(options.output / name, what, pose, all_lit if test else lit, spp, seed, options.radiance)
        print(name, flush=True)


if __name__ == "__main__":
    main()
