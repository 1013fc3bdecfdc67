"""Sampling budget of a refined picture: a fixed number of directions, or a target standard error."""

from collections.abc import Callable

from lambent_proto.pictures import RenderSettings

from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Light, Radiance, Scene, outgoing_radiance

MAX_ROUNDS = 64
"""Maximum number of rounds, after which a picture is returned even if it is noisier than requested."""
_NEXT_ROUND = 1_000_003


def estimated(
    points: SurfacePoints,
    scene: Scene,
    light: Light,
    settings: RenderSettings,
    progress: Callable[[float], None] | None,
) -> Radiance:
    """Return the radiance of `points` after one round, or as many as the target needs.

    The rays of a pixel share its directions, two each at least. They are averaged later: a pixel's
    error is that of its rays over `antialias`.
    """
    per_ray = max(2, -(-settings.spp // settings.antialias**2))
    total: Radiance | None = None
    needed = 1.0
    for number in range(MAX_ROUNDS if settings.until_stderr else 1):

        def advance(share: float, number: int = number, needed: float = needed) -> None:
            if progress is not None:
                progress(min(1.0, (number + share) / max(needed, number + 1.0)))

        found = outgoing_radiance(
            points,
            scene,
            light,
            num_samples=per_ray,
            seed=settings.seed + _NEXT_ROUND * number,
            indirect=settings.indirect,
            progress=advance,
        )
        total = found if total is None else total.combined(found)
        error = total.relative_error() / settings.antialias
        if not settings.until_stderr or error <= settings.until_stderr:
            break
        # Errors fall with the root of the rounds.
        needed = (number + 1) * (error / settings.until_stderr) ** 2
    assert total is not None
    return total
