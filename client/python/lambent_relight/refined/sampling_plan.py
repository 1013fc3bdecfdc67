"""How long a refined picture is sampled: a fixed number of directions, or until it is quiet enough."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

from lambent_relight.refined.scattering import SurfacePoints
from lambent_relight.refined.shading import Light, Radiance, Scene, outgoing_radiance

Bounces = Literal["auto", "adapted", "transport", "one"]
BOUNCES: tuple[str, ...] = get_args(Bounces)

MAX_ROUNDS = 64
"""Rounds after which a picture is returned although it is noisier than asked for."""
_NEXT_ROUND = 1_000_003


@dataclass(frozen=True)
class Sampling:
    """What one refined picture may cost."""

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
    """Return the radiance of `points` after one round, or as many as it takes.

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
        # Errors fall with the root of the rounds.
        needed = (number + 1) * (error / sampling.until_stderr) ** 2
    assert total is not None
    return total
