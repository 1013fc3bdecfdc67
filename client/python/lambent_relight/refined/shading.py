"""Quality `refined`: Monte Carlo relighting through the fast cache.

Outgoing radiance of a visible point x under a new light L:

    L_o = integral of f(omega_i) [(1 - a) L(omega_i) + a L_hit] cos d omega_i,

with a the opacity of what is in the way (`lambent_relight.refined.surroundings`): the mesh, or the fast
cache. L_hit is what the hit point sends back: from a fast cache that was adapted to L (a L_hit at once), or
from baked transport (`lambent_relight.baked.hits`), all bounces included, or what a random path from there
finds after a limited number of reflections. The estimate is unbiased but for the errors of these.
Source: paper Eq. 1 with the visibility of supplement 2.1; docs/reference/conventions.md.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass

import numpy as np
from lambent_compute.threads import in_order
from numpy.typing import NDArray

from lambent_relight.refined.known_light import KnownLight, Shares, Spread
from lambent_relight.refined.passes import Scene, one_pass
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.scattering import SurfacePoints

RAYS_PER_CHUNK = 1 << 16
"""Maximum number of secondary rays in memory, or a pixel's more."""
EVEN = 128
"""Directions of a pixel after which another pass is worth more than a longer one, which is even already."""
MAX_PASSES = 8


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
    shares: Shares
    """Of the known light that was mixed in, as `Spread.best_shares` says, [2, pixel]."""


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
    *,
    num_samples: int,
    seed: int,
    pixels: PixelRays | None = None,
    known: KnownLight | None = None,
    shares: Shares | None = None,
    progress: Callable[[float], None] | None = None,
) -> Radiance:
    """Return the radiance that `points` reflect towards their `omega_o`, with its standard error.

    `num_samples`, the directions per point (at least 2), is rounded up to whole passes. `pixels` says which
    points are rays of one pixel (default: every point is one of its own). `known` is what they reflect
    diffusely of light that is known (default: none), and `shares` how much of it makes up for noise (default:
    as makes least). Passes are independent; inside a pass the directions of a pixel are an even sequence.
    Equal seeds give equal results, whatever the number of threads.
    """
    num_points = len(points.position)
    pixels = PixelRays.alone(num_points) if pixels is None else pixels
    num_passes, per_pass = split_samples(num_samples, pixels.most)
    known = KnownLight.nothing(num_points) if known is None else known
    sums, spread = np.zeros((6, num_points, 3)), Spread.of(len(pixels.first))
    parts = pixels.parts(RAYS_PER_CHUNK // per_pass)
    tasks = [(number, index) for number in range(num_passes) for index in range(len(parts))]

    def work(task: tuple[int, int]) -> NDArray[np.float32]:
        rng = np.random.default_rng([seed, *task])
        run, rays = parts[task[1]]
        u = rays.uniforms(per_pass, rng)
        return one_pass(points[run], u, scene, rng, known[run])

    # In the order of the tasks, so that sums are the same for any number of threads.
    with closing(in_order(work, tasks, scene.num_threads)) as results:
        for done, ((_, index), values) in enumerate(zip(tasks, results, strict=True)):
            run, rays = parts[index]
            sums[:, run] += values
            first = pixels.pixel[run.start]
            here = slice(first, first + len(rays.first))
            rest = rays.mean(values[0].astype(np.float64) + values[1])
            spread.add(here, rest, rays.mean(values[4]), rays.mean(values[5]))
            if progress is not None:
                progress((done + 1) / len(tasks))
    means = sums / num_passes
    if shares is None:
        shares = spread.best_shares(pixels.mean(means[0] + means[1] + known.radiance))
    from_rays, taken_out = shares[:, pixels.pixel, None]
    if scene.indirect:
        means[1] += from_rays * means[4] + (1.0 - from_rays) * known.radiance
    if known.sky is not None:
        means[0] -= taken_out * (means[5] - known.sky.radiance)
    direct, bounced, specular, visibility = means[:4].astype(np.float32)
    return Radiance(
        direct=direct,
        indirect=bounced,
        specular=specular,
        visibility=visibility,
        standard_error=np.sqrt(spread.variance(shares)).astype(np.float32),
        num_samples=num_passes * per_pass,
        freedom=num_passes - 1,
        shares=shares,
    )
