"""The settings of a picture, as Python code gives them."""

from typing import Any, TypedDict

from lambent_core.errors import RelightError, SettingError, UnsupportedQuality
from lambent_core.pictures import Bounces, Occlusion, Quality, RenderSettings, ToneMapping
from numpy.typing import ArrayLike
from pydantic import ValidationError

from lambent_relight.validation import problems_of

Colour = tuple[float, float, float]
BACKGROUNDS: dict[str, str | Colour] = {
    "transparent": "transparent",
    "environment": "environment",
    "white": (1.0, 1.0, 1.0),
}
"""Backgrounds by name."""
_CODES = {"spp": "relight.num_samples", "quality": "relight.quality_unsupported"}


class Changes(TypedDict, total=False):
    """What `Renderer.render` takes by name: fields of RenderSettings, and what has no place in a manifest."""

    quality: Quality
    spp: int
    until_stderr: float
    antialias: int
    indirect: bool
    bounces: Bounces
    occlusion: Occlusion
    denoise: bool
    seed: int
    background: str | Colour | None
    """A name, or a linear colour."""
    exposure_ev: float
    """For screens, as is the next: without effect on linear pictures."""
    tone_mapping: ToneMapping
    albedo_ratio: ArrayLike | None
    """One or three factors on the stored albedo, by default the manifest's `albedo_scale_rgb`; the result is
    clipped to [0, 1]."""
    soft_edges: bool
    """Without them the mesh alone draws the outline of a `baked` picture: for a camera that moves."""


def settled(settings: RenderSettings | None = None, **changes: Any) -> RenderSettings:
    """Return `settings` (else the defaults) with some changed.

    Raises SettingError (`relight.<name>`), or UnsupportedQuality, for a value that cannot be used.
    """
    if settings is not None and not changes:
        return settings
    known = {} if settings is None else settings.model_dump(include=set(RenderSettings.model_fields))
    try:
        return RenderSettings(**(known | changes))
    except ValidationError as error:
        raise _refusal(error) from error


def _refusal(error: ValidationError) -> RelightError:
    problem = next(problems_of(error, RenderSettings))
    name = problem.pointer[1:]
    if name not in RenderSettings.model_fields:
        known = ", ".join(RenderSettings.model_fields)
        return SettingError("relight.setting_unknown", problem.message, f"settings are {known}")
    kind = UnsupportedQuality if name == "quality" else SettingError
    return kind(_CODES.get(name, f"relight.{name}"), problem.message, f"use {problem.expected}")
