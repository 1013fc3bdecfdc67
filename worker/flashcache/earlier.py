"""Settings of earlier releases, as far as runs and jobs that carry them can still be read."""

from collections.abc import Iterable, Mapping
from typing import Any

from flashcache.errors import ConfigError

REMOVED: Mapping[str, Any] = {
    "model.environment.texture_height": 0,
    "model.nerf.antialias": "none",
    "stage_one.shape_prior.late_recession_weight": 0.0,
    "stage_two.budget": {"error_share": 0.0},
    "stage_two.cache_weight": 1.0,
    "stage_two.environment_prior": {"white_weight": 0.0, "variation_weight": 0.0},
    "stage_two.estimator.environment_gradient": 1.0,
    "stage_two.estimator.roulette": 0.0,
    "stage_two.unobserved": {"weight": 0.0},
    "stage_two.weight_gradient": 0.0,
}
"""Settings of earlier releases, with the value that had no effect: runs with that value can be read."""


def check_removed(path: str, value: Any) -> None:
    """Raise `ConfigError` if a removed setting had an effect."""
    neutral = REMOVED[path]
    if isinstance(neutral, Mapping) and isinstance(value, Mapping):
        value = {name: value.get(name) for name in neutral}
    if value != neutral:
        raise ConfigError(
            f"setting {path!r} was removed and only {neutral!r} can still be read, got {value!r}; "
            "use the release that the run was made with, or train it again without this setting"
        )


def with_sizes(export: Mapping[str, Any], transport_size: int, *, step: int = 1) -> dict[str, Any]:
    """Return settings of an export that state `atlas_size`, but no `transport_size`, with both.

    Earlier releases had one size for albedo and transport. It is that of both where it is smaller than
    `transport_size`, which holds otherwise. It is rounded down to a multiple of `step`, which those releases
    did not ask for. What is no positive integer is left to the checks of values.
    """
    size = export["atlas_size"]
    if not isinstance(size, int) or isinstance(size, bool) or size < step:
        return {**export, "transport_size": transport_size}
    size -= size % step
    return {**export, "atlas_size": size, "transport_size": min(size, transport_size) or transport_size}


def in_steps(export: Mapping[str, Any], names: Iterable[str], step: int) -> dict[str, Any]:
    """Return settings of an export with the sizes `names` rounded down to multiples of `step`.

    Earlier releases did not ask for that. What is no integer of at least `step` is left to the checks of
    values.
    """
    return {**export, **{name: _in_steps(export[name], step) for name in names}}


def _in_steps(size: Any, step: int) -> Any:
    is_size = isinstance(size, int) and not isinstance(size, bool) and size >= step
    return size - size % step if is_size else size
