"""Quality `refined`: Monte Carlo relighting through the fast cache.

Outgoing radiance of a visible point x under a new light L:

    L_o = integral of f(omega_i) [(1 - a) L(omega_i) + a L_hit] cos d omega_i,

with a the fast cache's opacity along omega_i. L_hit is what the hit point, at the fast cache's distance,
sends back: from a fast cache that was adapted to L (a L_hit at once), or from baked transport
(`lambent_relight.baked.hits`), all bounces included, or what it reflects straight from L, with its own
material (both lobes) and its own fast-cache visibility. The estimate is unbiased but for the errors of these.
Source: paper Eq. 1 with the visibility of supplement 2.1; docs/reference/conventions.md.
"""

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from lambent_compute.threads import in_order
from numpy.typing import NDArray

from lambent_relight.brdf import cosine_pdf, materials_from_roughness
from lambent_relight.bundle.graphs import AdaptedHits, SurfaceCaches
from lambent_relight.directions import normalise
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.light_sampling import LightSampler
from lambent_relight.environment.maps import Environment
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.scattering import SurfacePoints, draw_directions, strategy_shares

RAYS_PER_CHUNK = 1 << 16
"""Maximum number of secondary rays in memory, or a pixel's more."""
EVEN = 128
"""Directions of a pixel after which another pass is worth more than a longer one, which is even already."""
MAX_PASSES = 8
FOLLOWED = 0.25
"""Rays blocked with at least this probability are always followed to the hit, others by chance."""


@dataclass(frozen=True)
class Light:
    """An environment and its sampler."""

    environment: Environment
    sampler: LightSampler


@dataclass(frozen=True)
class Scene:
    """The object that is lit."""

    caches: SurfaceCaches
    origin_offset: float
    """Secondary rays start this far along the normal, scene units."""
    edit: MaterialEdit
    """Changes to the bundle's material."""
    hits: Callable[[NDArray[np.float32], NDArray[np.float32]], NDArray[np.float32]] | None = None
    """Radiance of points [n, 3] towards directions [n, 3]; None: traced once more, see `hit_radiance`."""
    adapted: Callable[[NDArray[np.float32], NDArray[np.float32]], AdaptedHits] | None = None
    """Hits of rays [n, 3] and their radiance under exactly this light; takes precedence over `hits`."""
    num_threads: int = 1
    """Threads that may call these functions at once."""


@dataclass(frozen=True)
class Radiance:
    """Monte Carlo means over all passes, [point, 3] each but for the error."""

    direct: NDArray[np.float32]
    indirect: NDArray[np.float32]
    specular: NDArray[np.float32]
    """The specular lobe's part of `direct` + `indirect`."""
    visibility: NDArray[np.float32]
    """Cosine-weighted share of free directions, three times the same."""
    standard_error: NDArray[np.float32]
    """Of the mean of `direct` + `indirect` over the rays of a pixel, [pixel, 3]; its square is unbiased."""
    num_samples: int
    """Directions per point."""
    freedom: int
    """Degrees of freedom of `standard_error`: independent passes less one."""

    def combined(self, other: "Radiance") -> "Radiance":
        """Return the mean with an independent estimate, weighted by the number of samples."""
        total = self.num_samples + other.num_samples
        a, b = self.num_samples / total, other.num_samples / total
        names = ("direct", "indirect", "specular", "visibility")
        means = [np.float32(a) * getattr(self, n) + np.float32(b) * getattr(other, n) for n in names]
        error = np.sqrt((a * self.standard_error) ** 2 + (b * other.standard_error) ** 2)
        return Radiance(*means, error.astype(np.float32), total, self.freedom + other.freedom)

    def relative_error(self, pixels: PixelRays) -> float:
        """Return the mean standard error of `pixels` over their mean radiance, of all channels.

        The root of an unbiased variance is too small on average: 20 % with two passes, 4 % with eight. It is
        corrected as for normal errors.
        """
        if not len(self.direct):
            return 0.0
        mean = float(pixels.mean(self.direct + self.indirect).mean())
        half = 0.5 * self.freedom
        root = math.exp(math.lgamma(half + 0.5) - math.lgamma(half)) / math.sqrt(half)
        return float(self.standard_error.mean(dtype=np.float64)) / (root * mean) if mean > 0.0 else 0.0


def split_samples(num_samples: int, rays_per_pixel: int) -> tuple[int, int]:
    """Return (number of passes, directions of a ray per pass), `num_samples` or one pass's more in total.

    2 to 8 passes, with `EVEN` directions of a pixel where there are enough: more passes measure the noise
    better, longer ones make less of it.
    """
    num_passes = min(max(num_samples * rays_per_pixel // EVEN, 2), MAX_PASSES)
    return num_passes, -(-num_samples // num_passes)


def outgoing_radiance(
    points: SurfacePoints,
    scene: Scene,
    light: Light,
    *,
    num_samples: int,
    seed: int,
    indirect: bool,
    pixels: PixelRays | None = None,
    progress: Callable[[float], None] | None = None,
) -> Radiance:
    """Return the radiance that `points` reflect towards their `omega_o`, with its standard error.

    `num_samples`, the directions per point (at least 2), is rounded up to whole passes. `pixels` says which
    points are rays of one pixel (default: every point is one of its own). Passes are independent; inside a
    pass the directions of a pixel are an even sequence. Equal seeds give equal results, whatever the number
    of threads.
    """
    num_points = len(points.position)
    pixels = PixelRays.alone(num_points) if pixels is None else pixels
    num_passes, per_pass = split_samples(num_samples, pixels.most)
    sums, squares = np.zeros((4, num_points, 3)), np.zeros((len(pixels.first), 3))
    parts = pixels.parts(RAYS_PER_CHUNK // per_pass)
    tasks = [(number, index) for number in range(num_passes) for index in range(len(parts))]

    def work(task: tuple[int, int]) -> NDArray[np.float32]:
        rng = np.random.default_rng([seed, *task])
        run, rays = parts[task[1]]
        return _one_pass(points[run], rays, scene, light, per_pass, rng, indirect)

    # In the order of the tasks, so that sums are the same for any number of threads.
    with closing(in_order(work, tasks, scene.num_threads)) as results:
        for done, ((_, index), found) in enumerate(zip(tasks, results, strict=True)):
            run, rays = parts[index]
            sums[:, run] += found
            first = pixels.pixel[run.start]
            squares[first : first + len(rays.first)] += rays.mean(found[0].astype(np.float64) + found[1]) ** 2
            if progress is not None:
                progress((done + 1) / len(tasks))
    means = sums / num_passes
    mean = pixels.mean(means[0] + means[1])
    variance = np.maximum(squares / num_passes - mean**2, 0.0) / (num_passes - 1)
    error = np.sqrt(variance).astype(np.float32)
    return Radiance(*means.astype(np.float32), error, num_passes * per_pass, num_passes - 1)


def _one_pass(
    points: SurfacePoints,
    pixels: PixelRays,
    scene: Scene,
    light: Light,
    per_pass: int,
    rng: np.random.Generator,
    indirect: bool,
) -> NDArray[np.float32]:
    """Return means over `per_pass` directions of points [point, 3], [4, point, 3].

    Direct radiance, once-reflected radiance, the specular part of both, and the free share.
    """
    from lambent_relight.refined import scattering_kernels as kernels

    count = len(points.position)
    u = pixels.uniforms(per_pass, rng)
    drawn = draw_directions(points, light.sampler, u, strategy_shares(points, light.sampler))
    active = drawn.active
    owner = active // per_pass
    normal, direction = points.normal[owner], drawn.omega_i[active]
    origin = points.position[owner] + np.float32(scene.origin_offset) * normal
    adapted = scene.adapted(origin, direction) if indirect and scene.adapted is not None else None
    seen = scene.caches.secondary(origin, direction) if adapted is None else adapted
    arriving = (1.0 - seen.opacity) * light.environment.lookup(direction)
    bouncing = np.zeros_like(arriving) if adapted is None else adapted.radiance
    if indirect and adapted is None:
        # Below `FOLLOWED`, a hit of opacity a is followed with probability a / FOLLOWED, at weight FOLLOWED:
        # the mean is that of following all at weight a.
        hit = np.flatnonzero(FOLLOWED * rng.random(len(active)) < seen.opacity[:, 0])
        position = origin[hit] + seen.distance[hit] * direction[hit]
        if scene.hits is not None:
            bouncing[hit] = scene.hits(position, -direction[hit])
        else:
            bouncing[hit] = hit_radiance(position, -direction[hit], scene, light, rng.random((len(hit), 3)))
        bouncing[hit] *= np.maximum(seen.opacity[hit], np.float32(FOLLOWED))
    cosine = cosine_pdf(direction, normal)[:, 0] / drawn.pdf_solid_angle[active, 0]
    result = np.zeros((4, count, 3))
    lobes = (drawn.diffuse, drawn.specular)
    free = 1.0 - seen.opacity
    kernels.add_up(active, per_pass, *lobes, arriving, bouncing, cosine, free, result)
    return result.astype(np.float32)


def hit_radiance(
    position: NDArray[np.float32],
    omega_o: NDArray[np.float32],
    scene: Scene,
    light: Light,
    u: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return an unbiased estimate of the direct light that hit points reflect, [point, 3].

    One direction per point, drawn with the uniforms `u` [point, 3].
    """
    if len(position) == 0:
        return np.zeros((0, 3), np.float32)
    points = surface_at(position, omega_o, scene)
    drawn = draw_directions(points, light.sampler, u, strategy_shares(points, light.sampler))
    weight = drawn.weight
    active = drawn.active
    origin = position[active] + np.float32(scene.origin_offset) * points.normal[active]
    direction = drawn.omega_i[active]
    visibility = 1.0 - scene.caches.secondary(origin, direction).opacity
    radiance = np.zeros_like(weight)
    radiance[active] = weight[active] * visibility * light.environment.lookup(direction)
    return radiance


def surface_at(position: NDArray[np.float32], omega_o: NDArray[np.float32], scene: Scene) -> SurfacePoints:
    """Return the surface at points [point, 3], with the edit applied."""
    found = scene.caches.material(position)
    albedo, roughness = scene.edit.apply(found.albedo, found.perceptual_roughness)
    materials = materials_from_roughness(albedo, roughness, found.metalness)
    return SurfacePoints(position, normalise(found.normal), omega_o, materials)
