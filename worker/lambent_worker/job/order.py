"""What a job's order means as a configuration."""

from dataclasses import replace
from pathlib import Path

from flashcache.config import Config, Rates, with_overrides
from flashcache.errors import ConfigError
from flashcache.presets import preset as preset_of
from lambent_proto.v1 import job_pb2, worker_pb2

from lambent_worker.run.masks import AUTOMATIC, WHOLE_VIEW

# Parts of an order that are no settings of the method.
LIGHTS = "lights"
LAYOUT = "layout"
KNOWN_LIGHTS = "known_lights"
MASKS = "masks"


def config_of(
    spec: job_pb2.JobSpec, adjustments: worker_pb2.Adjustments
) -> tuple[Config, tuple[str, ...], str]:
    """Return the configuration, the training lights (none: the scene's first) and the layout ("": detect it).

    Raises `ConfigError` for an unknown preset or setting.
    """
    base = preset_of(spec.preset)
    own = (LIGHTS, LAYOUT, KNOWN_LIGHTS, MASKS)
    settings = {name: value for name, value in spec.params.items() if name not in own}
    config = adjust(with_overrides(base, settings), adjustments)
    lights = tuple(name.strip() for name in spec.params.get(LIGHTS, "").split(",") if name.strip())
    return config, lights, spec.params.get(LAYOUT, "")


def masks_of(spec: job_pb2.JobSpec, scene_dir: Path) -> tuple[Path | None, bool]:
    """Return the folder of masks of an order, and whether everything in view is the object without any.

    An order names a folder of its capture, or says "none". Raises `ConfigError` for a folder outside.
    """
    value = spec.params.get(MASKS, AUTOMATIC)
    if value in (AUTOMATIC, WHOLE_VIEW):
        return None, value == WHOLE_VIEW
    path = (scene_dir / value).resolve()
    if not path.is_relative_to(scene_dir.resolve()):
        raise ConfigError(
            f'{MASKS} "{value}" lies outside the capture; name a folder of the capture, or "{WHOLE_VIEW}"'
        )
    return path, False


def known_lights_of(spec: job_pb2.JobSpec, scene_dir: Path) -> list[str]:
    """Return the given environments of an order as `--known-light` takes them, with paths on this machine.

    An order names files of its capture: `sky.exr`, or `sunset=a.hdr,snow=b.hdr`. Raises `ConfigError` for one
    outside the capture.
    """
    items = []
    for item in filter(None, (item.strip() for item in spec.params.get(KNOWN_LIGHTS, "").split(","))):
        light, equals, name = item.rpartition("=")
        path = (scene_dir / name).resolve()
        if not path.is_relative_to(scene_dir.resolve()):
            raise ConfigError(f'{KNOWN_LIGHTS} "{name}" lies outside the capture; name a file of the capture')
        items.append(f"{light}{equals}{path}")
    return items


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
