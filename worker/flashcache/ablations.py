"""The paper's ablations as changed settings; all share stage one with the full method."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from flashcache.config import Config
from flashcache.errors import ConfigError
from flashcache.physical.estimator import DirectionCounts

_ESTIMATOR = "stage_two.estimator"


@dataclass(frozen=True, kw_only=True, slots=True)
class Ablation:
    """One row of an ablation table."""

    label: str
    """The row's name in a table."""
    settings: Callable[[Config], Mapping[str, str]]
    """Settings that differ from a configuration, in the form that `with_overrides` accepts."""


def ablation_settings(config: Config, name: str) -> dict[str, str]:
    """Return the settings in which the ablation `name` of `config` differs from it, for `with_overrides`.

    All of them belong to stage two or to what comes after it. Raises `ConfigError` for an unknown name.
    """
    if name not in ABLATIONS:
        raise ConfigError(f"unknown ablation {name!r}; choose from {', '.join(ABLATIONS)}")
    return dict(ABLATIONS[name].settings(config))


def _fixed(settings: Mapping[str, str]) -> Callable[[Config], Mapping[str, str]]:
    """Return settings that do not depend on the configuration."""
    return lambda _config: settings


def _points_per_ray(count: int) -> Callable[[Config], Mapping[str, str]]:
    """Return settings that shade `count` points per ray with as many secondary rays per pixel as before."""

    def settings(config: Config) -> Mapping[str, str]:
        estimator = config.stage_two.estimator
        changed = {"stage_two.points_per_ray": str(count)}
        for kind in ("fast", "exact"):
            counts: DirectionCounts = getattr(estimator, kind).divided(count)
            for strategy in ("cosine", "sampler", "specular"):
                changed[f"{_ESTIMATOR}.{kind}.{strategy}"] = json.dumps(getattr(counts, strategy))
        return changed

    return settings


_NO_CONTROL_VARIATE = {f"{_ESTIMATOR}.control_variate": "off"}
_NO_SAMPLER = {**_NO_CONTROL_VARIATE, f"{_ESTIMATOR}.sampler": "none"}
_DEPTH = {**_NO_SAMPLER, "stage_two.points": "depth"}

ABLATIONS: dict[str, Ablation] = {
    "full": Ablation(label="full method", settings=_fixed({})),
    "no_control_variate": Ablation(
        label="no control variate (NeRF cache only)", settings=_fixed(_NO_CONTROL_VARIATE)
    ),
    "no_sampler": Ablation(label="and no light sampler", settings=_fixed(_NO_SAMPLER)),
    "depth": Ablation(label="and one point at the median depth", settings=_fixed(_DEPTH)),
    "fast_without_sampler": Ablation(
        label="control variate, no light sampler", settings=_fixed({f"{_ESTIMATOR}.sampler": "none"})
    ),
    "fast_only": Ablation(
        label="fast cache only (biased)", settings=_fixed({f"{_ESTIMATOR}.control_variate": "fast_only"})
    ),
    "no_polish": Ablation(label="no polish of the materials", settings=_fixed({"polish": "off"})),
    "polish": Ablation(label="materials polished after stage two", settings=_fixed({"polish": "on"})),
    "no_cache_gradient": Ablation(
        label="no gradient through the caches", settings=_fixed({f"{_ESTIMATOR}.through_cache": "0.0"})
    ),
    "cache_gradient": Ablation(
        label="gradient through the caches", settings=_fixed({f"{_ESTIMATOR}.through_cache": "1e-4"})
    ),
    **{
        f"k{count}": Ablation(label=f"K = {count}", settings=_points_per_ray(count)) for count in (1, 2, 4, 8)
    },
}
"""By name, in the order of the paper's tables."""
