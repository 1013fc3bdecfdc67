"""Quality `refined`: Monte Carlo relighting through the fast cache.

Outgoing radiance of a visible point x under a new light L:

    L_o = integral of f(omega_i) [(1 - a) L(omega_i) + a L_hit] cos d omega_i,

with a the fast cache's opacity along omega_i. L_hit is what the hit point, at the fast cache's distance,
sends back: from a fast cache that was adapted to L (a L_hit at once), or from baked transport
(`lambent_relight.baked.hits`), all bounces included, or what it reflects straight from L, with its own
material (both lobes) and its own fast-cache visibility. The estimate is unbiased but for the errors of these.
Source: paper Eq. 1 with the visibility of supplement 2.1; docs/reference/conventions.md.
"""

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
from lambent_relight.refined.scattering import SurfacePoints, draw_directions, strategy_shares, whole_shares

RAYS_PER_CHUNK = 1 << 16
"""Maximum number of secondary rays in memory."""
# Fractional parts of multiples of these fill the unit square evenly (Roberts' R2 sequence).
_R2 = 1.32471795724474602596 ** -np.arange(1.0, 3.0)


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
    """Monte Carlo means over all passes, [point, 3] each."""

    direct: NDArray[np.float32]
    indirect: NDArray[np.float32]
    specular: NDArray[np.float32]
    """The specular lobe's part of `direct` + `indirect`."""
    visibility: NDArray[np.float32]
    """Cosine-weighted share of free directions, three times the same."""
    standard_error: NDArray[np.float32]
    """Of `direct` + `indirect`."""
    num_samples: int

    def combined(self, other: "Radiance") -> "Radiance":
        """Return the mean with an independent estimate, weighted by the number of samples."""
        total = self.num_samples + other.num_samples
        a, b = self.num_samples / total, other.num_samples / total
        names = ("direct", "indirect", "specular", "visibility")
        means = [np.float32(a) * getattr(self, n) + np.float32(b) * getattr(other, n) for n in names]
        error = np.sqrt((a * self.standard_error) ** 2 + (b * other.standard_error) ** 2)
        return Radiance(*means, error.astype(np.float32), total)

    def relative_error(self) -> float:
        """Return the mean standard error over the mean radiance, of all points and channels."""
        mean = float((self.direct + self.indirect).mean(dtype=np.float64)) if len(self.direct) else 0.0
        return float(self.standard_error.mean(dtype=np.float64)) / mean if mean > 0.0 else 0.0


def split_samples(num_samples: int) -> tuple[int, int]:
    """Return (number of passes, directions per pass), `num_samples` or a little more in total.

    2 to 8 passes, of four directions where there are enough: more passes measure the noise better, longer
    ones make less of it.
    """
    num_passes = min(max(num_samples // 4, 2), 8)
    return num_passes, -(-num_samples // num_passes)


def outgoing_radiance(
    points: SurfacePoints,
    scene: Scene,
    light: Light,
    *,
    num_samples: int,
    seed: int,
    indirect: bool,
    progress: Callable[[float], None] | None = None,
) -> Radiance:
    """Return the radiance that `points` reflect towards their `omega_o`, with its standard error.

    `num_samples` (at least 2) is rounded up to whole passes. Passes are independent; inside a pass the
    directions of a point are a randomly shifted even sequence. Equal seeds give equal results, whatever the
    number of threads.
    """
    num_passes, per_pass = split_samples(num_samples)
    num_points = len(points.position)
    sums = np.zeros((5, num_points, 3))
    chunk = max(1, RAYS_PER_CHUNK // per_pass)
    starts = range(0, num_points, chunk)
    tasks = [(number, index) for number in range(num_passes) for index in range(len(starts))]

    def work(task: tuple[int, int]) -> NDArray[np.float32]:
        rng = np.random.default_rng([seed, *task])
        start = starts[task[1]]
        return _one_pass(points[start : start + chunk], scene, light, per_pass, rng, indirect)

    # In the order of the tasks, so that sums are the same for any number of threads.
    with closing(in_order(work, tasks, scene.num_threads)) as results:
        for done, ((_, index), found) in enumerate(zip(tasks, results, strict=True)):
            part = slice(starts[index], starts[index] + chunk)
            sums[:4, part] += found
            sums[4, part] += (found[0].astype(np.float64) + found[1]) ** 2
            if progress is not None:
                progress((done + 1) / len(tasks))
    means = sums / num_passes
    variance = np.maximum(means[4] - (means[0] + means[1]) ** 2, 0.0) / (num_passes - 1)
    single = means[:4].astype(np.float32)
    return Radiance(*single, np.sqrt(variance).astype(np.float32), num_passes * per_pass)


def _one_pass(
    points: SurfacePoints, scene: Scene, light: Light, per_pass: int, rng: np.random.Generator, indirect: bool
) -> NDArray[np.float32]:
    """Return means over `per_pass` directions of points [point, 3], [4, point, 3].

    Direct radiance, once-reflected radiance, the specular part of both, and the free share.
    """
    from lambent_relight.refined import scattering_kernels as kernels

    count = len(points.position)
    u = _even_uniforms(count, per_pass, rng).reshape(-1, 3)
    shares = whole_shares(strategy_shares(points.materials), per_pass)
    drawn = draw_directions(points, light.sampler, u, shares)
    active = drawn.active
    owner = active // per_pass
    normal, direction = points.normal[owner], drawn.omega_i[active]
    origin = points.position[owner] + np.float32(scene.origin_offset) * normal
    adapted = scene.adapted(origin, direction) if indirect and scene.adapted is not None else None
    seen = scene.caches.secondary(origin, direction) if adapted is None else adapted
    arriving = (1.0 - seen.opacity) * light.environment.lookup(direction)
    bouncing = np.zeros_like(arriving) if adapted is None else adapted.radiance
    if indirect and adapted is None:
        # Following a hit with probability a, at full weight, has the mean of following all at weight a.
        hit = np.flatnonzero(rng.random(len(active)) < seen.opacity[:, 0])
        position = origin[hit] + seen.distance[hit] * direction[hit]
        if scene.hits is not None:
            bouncing[hit] = scene.hits(position, -direction[hit])
        else:
            bouncing[hit] = hit_radiance(position, -direction[hit], scene, light, rng.random((len(hit), 3)))
    cosine = cosine_pdf(direction, normal)[:, 0] / drawn.pdf_solid_angle[active, 0]
    result = np.zeros((4, count, 3))
    lobes = (drawn.diffuse, drawn.specular)
    free = 1.0 - seen.opacity
    kernels.add_up(active, per_pass, *lobes, arriving, bouncing, cosine, free, result)
    return result.astype(np.float32)


def _even_uniforms(count: int, per_pass: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return uniforms in [0, 1), [count, per_pass, 3], evenly spread over the second axis.

    The first is stratified in rising order, so that every sampling strategy gets consecutive elements of
    the sequence that the other two follow, and as many as its share says, give or take one.
    """
    index = np.arange(per_pass)[:, None]
    first = (index + rng.random((count, 1, 1))) / per_pass
    rest = (rng.random((count, 1, 2)) + index * _R2) % 1.0
    return np.concatenate([np.broadcast_to(first, (count, per_pass, 1)), rest], axis=-1)


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
    drawn = draw_directions(points, light.sampler, u, strategy_shares(points.materials))
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
