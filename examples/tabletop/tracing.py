"""Path tracing with our own rays: radiance, coverage and true maps of a camera with distortion."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from tabletop.cameras import Camera

MAX_DEPTH = 5
LANES = 8_000_000
"""Rays traced at a time, which bounds memory to about 2 GB."""
NUM_FACES = 6
"""Directions that a normal is counted among; shapes are shaded face by face."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FirstHits:
    """What rays meet first."""

    colour: np.ndarray
    """Linear base colour [rays, 3]; the environment's radiance where nothing is met."""
    label: np.ndarray
    """Face of a shape [rays]: 6 times the shape's number plus that of the face, -1 where nothing is met."""
    normal: np.ndarray
    """World normal [rays, 3]."""


def rays(camera: Camera, index: "mi.UInt32", jitter: "mi.Point2f") -> "mi.RayDifferential3f":
    """Return rays through pixels (numbered row by row), at `jitter` in [0, 1) from their corners."""
    row = index // camera.width
    column = index - row * camera.width
    x = (mi.Float(column) + jitter.x - 0.5 * camera.width) / camera.focal
    y = (mi.Float(row) + jitter.y - 0.5 * camera.height) / camera.focal
    x, y = camera.undistorted(x, y)
    pose = camera.camera_to_world
    matrix = mi.Matrix3f(pose[:3, :3].astype(np.float32).tolist())
    eye = mi.Point3f(*map(float, pose[:3, 3]))
    # Constants of a view would be compiled into its kernel, and no two views could share one.
    dr.make_opaque(matrix, eye)
    direction = dr.normalize(matrix @ mi.Vector3f(x, -y, -1.0))
    return mi.RayDifferential3f(mi.Ray3f(eye, direction))


def integrator(*, alone: bool = False) -> "mi.Integrator":
    """Return the path integrator; dark paths end early by chance. `alone`: on no background."""
    return mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": 2, "hide_emitters": alone})


def radiance(
    scene: "mi.Scene", camera: Camera, spp: int, seed: int, *, alone: bool = False, limit: float = 1e6
) -> np.ndarray:
    """Return mean linear radiance [H, W, 3], or [H, W, 4] premultiplied, of an object `alone`.

    Paths of more than `limit` count as `limit`, which removes bright specks.
    """
    tracer = integrator(alone=alone)
    sampler = mi.load_dict({"type": "independent"})
    pixels = camera.width * camera.height
    at_once = min(pixels, max(camera.width, LANES // spp))
    parts = []
    for number, first in enumerate(range(0, pixels, at_once)):
        count = min(at_once, pixels - first)
        sampler.seed(dr.opaque(mi.UInt32, seed * 1009 + number), count * spp)
        index = dr.arange(mi.UInt32, count * spp) // spp + dr.opaque(mi.UInt32, first)
        value, valid, _ = tracer.sample(scene, sampler, rays(camera, index, sampler.next_2d()))
        most = dr.opaque(mi.Float, limit)
        columns = [dr.minimum(column, most) for column in (value.x, value.y, value.z)]
        if alone:
            columns = [dr.select(valid, column, 0.0) for column in columns] + [
                dr.select(valid, mi.Float(1), 0)
            ]
        parts.append(_means(columns, spp))
    return np.concatenate(parts).reshape(camera.height, camera.width, -1)


def radiance_of(
    scene: "mi.Scene",
    shape: "mi.Shape",
    camera: Camera,
    pixels: np.ndarray,
    spp: int,
    seed: int,
    limit: float,
) -> np.ndarray:
    """Return [n, 4] for pixel numbers [n]: radiance of `shape` alone, premultiplied, and its coverage.

    Paths of more than `limit` count as `limit`, which removes bright specks far above white.
    """
    tracer = integrator()
    sampler = mi.load_dict({"type": "independent"})
    at_once = LANES // spp
    parts = [np.zeros((0, 4))]
    for number, first in enumerate(range(0, len(pixels), at_once)):
        some = mi.UInt32(pixels[first : first + at_once].astype(np.uint32))
        lanes = dr.width(some) * spp
        sampler.seed(dr.opaque(mi.UInt32, seed * 1013 + number), lanes)
        index = dr.gather(mi.UInt32, some, dr.arange(mi.UInt32, lanes) // spp)
        ray = rays(camera, index, sampler.next_2d())
        met = scene.ray_intersect_preliminary(ray)
        seen = met.is_valid() & (met.shape == mi.ShapePtr(shape))
        value, _, _ = tracer.sample(scene, sampler, ray, active=seen)
        most = dr.opaque(mi.Float, limit)
        columns = [dr.select(seen, dr.minimum(column, most), 0.0) for column in (value.x, value.y, value.z)]
        parts.append(_means([*columns, dr.select(seen, mi.Float(1.0), 0.0)], spp))
    return np.concatenate(parts)


def first_hits(scene: "mi.Scene", camera: Camera, dx: float, dy: float) -> FirstHits:
    """Return what the ray through (dx, dy) of every pixel meets, row by row; (0.5, 0.5) is the middle."""
    index = dr.arange(mi.UInt32, camera.width * camera.height)
    jitter = mi.Point2f(dr.opaque(mi.Float, dx), dr.opaque(mi.Float, dy))
    ray = rays(camera, index, jitter)
    hit = scene.ray_intersect(ray)
    met = hit.is_valid()
    bsdf = hit.bsdf()
    colour = bsdf.eval_attribute_3("base_color", hit, met)
    far = scene.environment().eval(hit, ~met)
    colour = dr.select(met, colour, mi.Color3f(far.x, far.y, far.z))
    normal = hit.sh_frame.n * -dr.sign(dr.dot(hit.sh_frame.n, ray.d))
    shape = dr.reinterpret_array(mi.UInt32, hit.shape)
    dr.eval(colour, normal, shape)
    directions = np.array(normal).T
    axis = np.abs(directions).argmax(axis=-1)
    face = 2 * axis + (np.take_along_axis(directions, axis[:, None], 1)[:, 0] > 0)
    label = np.where(np.array(met), np.array(shape).astype(np.int64) * NUM_FACES + face, -1)
    return FirstHits(colour=np.array(colour).T, label=label, normal=directions)


def coverage_of(
    scene: "mi.Scene", shape: "mi.Shape", camera: Camera, pixels: np.ndarray, side: int
) -> np.ndarray:
    """Return the share [n] of pixels (numbers [n]) through which `shape` is seen, of `side` x `side` rays."""
    per_pixel, parts = side * side, [np.zeros(0)]
    at_once = LANES // per_pixel
    for first in range(0, len(pixels), at_once):
        some = mi.UInt32(pixels[first : first + at_once].astype(np.uint32))
        lane = dr.arange(mi.UInt32, dr.width(some) * per_pixel)
        index = dr.gather(mi.UInt32, some, lane // per_pixel)
        sub = lane % per_pixel
        down = sub // side
        jitter = mi.Point2f((mi.Float(sub - down * side) + 0.5) / side, (mi.Float(down) + 0.5) / side)
        met = scene.ray_intersect_preliminary(rays(camera, index, jitter))
        seen = met.is_valid() & (met.shape == mi.ShapePtr(shape))
        parts.append(_means([dr.select(seen, mi.Float(1.0), 0.0)], per_pixel)[:, 0])
    return np.concatenate(parts)


def number_of(shape: "mi.Shape") -> int:
    """Return the number that labels of a shape's faces are built on."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _means(columns: list["mi.Float"], per_pixel: int) -> np.ndarray:
    sums = [dr.block_sum(column, per_pixel) for column in columns]
    dr.eval(sums)
    return np.stack([np.array(total) for total in sums], axis=-1) / per_pixel


def maps(scene: "mi.Scene", camera: Camera, shape: "mi.Shape", side: int) -> dict[str, np.ndarray]:
    """Return true maps of what is seen of `shape`: means over `side` x `side` rays per pixel.

    `coverage` [H, W] counts rays that meet the shape before anything else. The others are means over those
    rays: albedo and normal [H, W, 3] (world, facing the camera, not renormalised), roughness, metallic and
    distance (along the ray) [H, W].
    """
    per_pixel = side * side
    pixels = camera.width * camera.height
    at_once = min(pixels, LANES // per_pixel)
    parts: list[np.ndarray] = []
    for first in range(0, pixels, at_once):
        count = min(at_once, pixels - first)
        sub = dr.arange(mi.UInt32, count * per_pixel) % per_pixel
        down = sub // side
        jitter = mi.Point2f((mi.Float(sub - down * side) + 0.5) / side, (mi.Float(down) + 0.5) / side)
        index = dr.arange(mi.UInt32, count * per_pixel) // per_pixel + dr.opaque(mi.UInt32, first)
        ray = rays(camera, index, jitter)
        hit = scene.ray_intersect(ray)
        seen = hit.is_valid() & (hit.shape == mi.ShapePtr(shape))
        bsdf = hit.bsdf()
        colour = bsdf.eval_attribute_3("base_color", hit, seen)
        normal = hit.sh_frame.n * -dr.sign(dr.dot(hit.sh_frame.n, ray.d))
        columns = [mi.Float(1), colour.x, colour.y, colour.z, normal.x, normal.y, normal.z]
        columns += [bsdf.eval_attribute_1(name, hit, seen) for name in ("roughness", "metallic")]
        columns += [hit.t]
        parts.append(_means([dr.select(seen, column, 0.0) for column in columns], per_pixel))
    share = np.concatenate(parts).reshape(camera.height, camera.width, -1)
    mean = share[..., 1:] / np.maximum(share[..., :1], 1e-6)
    return {
        "coverage": share[..., 0],
        "albedo": mean[..., 0:3],
        "normal": mean[..., 3:6],
        "roughness": mean[..., 6],
        "metallic": mean[..., 7],
        "distance": mean[..., 8],
    }
