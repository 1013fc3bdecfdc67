"""Sampling budget of a refined picture: a fixed number of directions, or a target standard error."""

import math
from collections.abc import Callable

from lambent_proto.pictures import RenderSettings

from lambent_relight.refined.known_bounce import KnownBounce
from lambent_relight.refined.pixel_rays import PixelRays
from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Light, Radiance, Scene, outgoing_radiance

MAX_FACTOR = 64
"""A picture that is still noisier than requested is returned after this many times `spp` directions."""
GROWTH = 3
"""Largest ratio of a round to all before it, which say how much is needed, and a short one says little."""
_NEXT_ROUND = 1_000_003


def estimated(
    points: SurfacePoints,
    pixels: PixelRays,
    scene: Scene,
    light: Light,
    settings: RenderSettings,
    progress: Callable[[float], None] | None,
    known: KnownBounce | None = None,
) -> Radiance:
    """Return the radiance of `points`, the rays of `pixels`, after one round, or as many as the target needs.

    The rays of a pixel share its directions, two each at least.
    """
    per_ray = max(2, -(-settings.spp // settings.antialias**2))
    total: Radiance | None = None
    number, spent, wanted, needed = 0, 0, per_ray, float(per_ray)
    while True:

        def advance(share: float, spent: int = spent, wanted: int = wanted, needed: float = needed) -> None:
            if progress is not None:
                progress(min(1.0, (spent + share * wanted) / max(needed, spent + wanted)))

        found = outgoing_radiance(
            points,
            scene,
            light,
            num_samples=wanted,
            seed=settings.seed + _NEXT_ROUND * number,
            indirect=settings.indirect,
            pixels=pixels,
            known=known,
            progress=advance,
        )
        total = found if total is None else total.combined(found)
        number, spent = number + 1, total.num_samples
        error = total.relative_error(pixels)
        if not settings.until_stderr or error <= settings.until_stderr or spent >= MAX_FACTOR * per_ray:
            return total
        # Errors fall with the root of the directions, or faster.
        needed = min(spent * (error / settings.until_stderr) ** 2, float(MAX_FACTOR * per_ray))
        wanted = min(max(math.ceil(needed) - spent, per_ray), GROWTH * spent)
