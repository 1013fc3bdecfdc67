"""What a job's order means as a configuration."""

from dataclasses import replace

from flashcache.config import Config, Rates, with_overrides
from flashcache.presets import preset as preset_of
from lambent_proto.v1 import job_pb2, worker_pb2

# Parts of an order that are no settings of the method.
LIGHTS = "lights"
LAYOUT = "layout"


def config_of(
    spec: job_pb2.JobSpec, adjustments: worker_pb2.Adjustments
) -> tuple[Config, tuple[str, ...], str]:
    """Return the configuration, the training lights (none: the scene's first) and the layout ("": detect it).

    Raises `ConfigError` for an unknown preset or setting.
    """
    base = preset_of(spec.preset)
    settings = {name: value for name, value in spec.params.items() if name not in (LIGHTS, LAYOUT)}
    config = adjust(with_overrides(base, settings), adjustments)
    lights = tuple(name.strip() for name in spec.params.get(LIGHTS, "").split(",") if name.strip())
    return config, lights, spec.params.get(LAYOUT, "")


def adjust(config: Config, adjustments: worker_pb2.Adjustments) -> Config:
    """Return the configuration with fewer rays or lower rates in the stage that failed."""
    rays, rate = adjustments.ray_chunk or 1.0, adjustments.learning_rate or 1.0
    if adjustments.stage == "cache":
        one = config.stage_one
        one = replace(one, num_rays=max(int(one.num_rays * rays), 1), rates=_slower(one.rates, rate))
        return replace(config, stage_one=one)
    if adjustments.stage == "joint":
        two = config.stage_two
        two = replace(
            two,
            num_rays=max(int(two.num_rays * rays), 1),
            material_rates=_slower(two.material_rates, rate),
            cache_rates=_slower(two.cache_rates, rate),
            fast_rates=_slower(two.fast_rates, rate),
            environment_rate=two.environment_rate * rate,
        )
        return replace(config, stage_two=two)
    return config


def _slower(rates: Rates, factor: float) -> Rates:
    return replace(rates, grid=rates.grid * factor, network=rates.network * factor)
