"""The method's settings of a run: those of a preset, adjusted after failures, and as `run.json` has them.

They are imported, and torch with them, only for a run that has some: photographs are prepared without.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from flashcache.errors import ConfigError
from lambent_core.errors import UsageError
from lambent_proto.v1 import worker_pb2

if TYPE_CHECKING:
    from flashcache.config import Config, Rates


def config_for(name: str, overrides: Mapping[str, str]) -> "Config":
    """Return a preset, or `PRESET:SCENE` for a published scene, with settings changed.

    Raises `UsageError` for an unknown name and `ConfigError` for a wrong setting.
    """
    from flashcache.config import with_overrides
    from flashcache.presets import preset as preset_of

    try:
        base = preset_of(name)
    except ConfigError as error:
        raise UsageError("config.preset_unknown", f'--preset "{name}": {error}') from error
    return with_overrides(base, overrides)


def adjust(config: "Config", adjustments: worker_pb2.Adjustments) -> "Config":
    """Return the configuration with fewer rays or lower rates in the stages that failed."""
    for stage, own in adjustments.stages.items():
        rays, rate = own.ray_chunk or 1.0, own.learning_rate or 1.0
        if stage == "cache":
            one = config.stage_one
            one = replace(one, num_rays=max(int(one.num_rays * rays), 1), rates=_slower(one.rates, rate))
            config = replace(config, stage_one=one)
        elif stage == "joint":
            two = config.stage_two
            two = replace(
                two,
                num_rays=max(int(two.num_rays * rays), 1),
                material_rates=_slower(two.material_rates, rate),
                gloss_rates=_slower(two.gloss_rates, rate),
                cache_rates=_slower(two.cache_rates, rate),
                fast_rates=_slower(two.fast_rates, rate),
                environment_rate=two.environment_rate * rate,
            )
            config = replace(config, stage_two=two)
    return config


def config_record(config: "Config | None") -> dict[str, Any] | None:
    """Return the settings as `run.json` has them: null for a run that is only prepared so far."""
    if config is None:
        return None
    from flashcache.config import to_dict

    return to_dict(config)


def config_of(record: Mapping[str, Any] | None) -> "Config | None":
    """Return the settings that `run.json` has; needs torch where there are some."""
    if record is None:
        return None
    from flashcache.config import Config, from_dict

    return from_dict(Config, record)


def _slower(rates: "Rates", factor: float) -> "Rates":
    return replace(rates, grid=rates.grid * factor, network=rates.network * factor)
