"""Sampling budget of a refined picture: a fixed number of directions, or a target standard error."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Light, Radiance, Scene, outgoing_radiance

Bounces = Literal["auto", "adapted", "transport", "one"]
BOUNCES: tuple[str, ...] = get_args(Bounces)

MAX_ROUNDS = 64
"""Maximum number of rounds, after which a picture is returned even if it is noisier than requested."""
_NEXT_ROUND = 1_000_003


@dataclass(frozen=True)
class Sampling:
    """The sampling budget of one refined picture."""

    num_samples: int
    """Light directions per pixel and round."""
    seed: int
    indirect: bool
    antialias: int
    until_stderr: float
    """Relative standard error to reach, 0: one round."""
    bounces: Bounces

    @property
    def per_ray(self) -> int:
        """Light directions per camera ray and round, two at least."""
        return max(2, -(-self.num_samples // self.antialias**2))


def estimated(
    points: SurfacePoints,
    scene: Scene,
    light: Light,
    sampling: Sampling,
    progress: Callable[[float], None] | None,
) -> Radiance:
    """Return the radiance of `points` after one round, or as many as the target needs.

    The rays of a pixel are averaged later: a pixel's error is that of its rays over `antialias`.
    """
    total: Radiance | None = None
    needed = 1.0
    for number in range(MAX_ROUNDS if sampling.until_stderr else 1):

        def advance(share: float, number: int = number, needed: float = needed) -> None:
            if progress is not None:
                progress(min(1.0, (number + share) / max(needed, number + 1.0)))

        found = outgoing_radiance(
            points,
            scene,
            light,
            num_samples=sampling.per_ray,
            seed=sampling.seed + _NEXT_ROUND * number,
            indirect=sampling.indirect,
            progress=advance,
        )
        total = found if total is None else total.combined(found)
        error = total.relative_error() / sampling.antialias
        if not sampling.until_stderr or error <= sampling.until_stderr:
            break
        # Errors decrease with the square root of the number of rounds.
        needed = (number + 1) * (error / sampling.until_stderr) ** 2
    assert total is not None
    return total
