"""The settings of an evaluation, and the model and scene it works on."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

from flashcache.config import StageTwoConfig
from flashcache.data.scene import Scene, View
from flashcache.evaluation.lpips import Lpips
from flashcache.evaluation.monte_carlo import RenderRule
from flashcache.physical.model import InverseModel
from jaxtyping import Float32
from lambent_relight.bundle.uncertainty import UncertaintyGrid
from numpy import ndarray

from lambent_worker.errors import UsageError

Shadows = Literal["fast", "nerf"]
UNSCALED_VIEWS = 5
"""Views that are relit a second time without the albedo ratio."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluationRequest:
    """Settings of an evaluation."""

    num_views: int = 0
    """Test views, evenly spaced; 0 for all."""
    num_repeats: int = 4
    """Repeats behind every Monte Carlo picture."""
    num_directions: int = 64
    """Secondary rays per pixel and repeat."""
    antialias: int = 2
    """Camera rays along each side of a pixel; 1 is a ray through its centre, as in the paper."""
    environments: Path | None = None
    """Folder of maps named like the scene's relighting lights."""
    max_side: int = 0
    """Longer side of the pictures in pixels; 0 for that of the files."""
    shadows: Shadows = "fast"
    """Cache that provides shadows under new light; the paper's figures use the NeRF cache."""
    lpips_weights: tuple[Path, ...] = ()
    """Files with the weights of LPIPS; empty for a report without it."""
    exr: bool = False
    """Also write Monte Carlo pictures as EXR: linear, unclipped, with their standard error."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Subject:
    """A trained model, the scene it is compared with, and where the predictions go."""

    model: InverseModel
    scene: Scene
    views: tuple[View, ...]
    """The views to evaluate."""
    held_out: bool
    """Whether the views were kept from training."""
    maps: Mapping[str, Float32[ndarray, "rows columns 3"]]
    """Environments to relight with, by the name of the light, linear radiance."""
    request: EvaluationRequest
    seed: int
    out: Path
    advance: Callable[[], None]
    """Called after every picture; raises `Stopped` when the run is asked to stop."""
    rule: RenderRule = field(default_factory=RenderRule)
    """Estimator with which the model was trained and is rendered."""
    dataset: str = ""
    """Layout of the capture; some data sets have rules of their own."""
    lpips: Lpips | None = None
    uncertainty: UncertaintyGrid | None = None
    """Uncertainty of the materials, if it was measured."""
    true_lights: Mapping[str, Float32[ndarray, "rows columns 3"]] = field(default_factory=dict)
    """True environments of training lights, where they are known: linear radiance."""
    grey_card: bool = False
    """Whether albedo and light were brought to a grey card."""

    @property
    def known_lights(self) -> tuple[str, ...]:
        """Return the training lights whose environment was given and not learned."""
        known = self.model.domain.known_lights
        return self.scene.lights if known and self.shared_light else known

    @property
    def shared_light(self) -> bool:
        """Return whether the training lights are one environment, turned about the vertical."""
        return bool(self.model.domain.rotations_deg)


def rule_of(settings: StageTwoConfig, shadows: Shadows = "fast") -> RenderRule:
    """Return the estimator for rendering a run trained with `settings`: the one it was trained with."""
    return RenderRule(
        control_variate=settings.estimator.control_variate,
        sampler=settings.estimator.sampler,
        points=settings.points,
        shadows=shadows,
    )


def as_shadows(name: str) -> Shadows:
    """Return `name` where it is one of the caches; raises `UsageError` otherwise."""
    if name not in ("fast", "nerf"):
        raise UsageError("evaluate.shadows_unknown", f'--shadows "{name}" is neither fast nor nerf')
    return cast(Shadows, name)
