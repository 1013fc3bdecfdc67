"""The settings of a picture, as Python code gives them."""

from typing import Any

from lambent_core.errors import RelightError, SettingError, UnsupportedQuality
from lambent_core.pictures import RenderSettings
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
