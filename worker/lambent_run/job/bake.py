"""A job of the kind `bake`: reads its order and adapts the bundle that it publishes."""

from dataclasses import replace
from pathlib import Path

from flashcache.errors import ConfigError
from flashcache.training.light_bake import LightBakeConfig
from lambent_core.errors import UsageError
from lambent_proto.v1 import worker_pb2

from lambent_run.job.order import Order
from lambent_run.run.light_bake import BakeRequest, bake_light

OUT = "adapted"


def run_bake(order: Order) -> Path:
    """Adapt the bundle in bundle/ of the inputs to environment.* there and return the new bundle's folder.

    Raises ConfigError for settings that cannot be read, UsageError `bake.input_missing` where the server sent
    no bundle or no environment: they were deleted since.
    """
    inputs = order.scene_dir
    maps = sorted(inputs.glob("environment.*"))
    if not maps or not (inputs / "bundle").is_dir():
        raise UsageError(
            "bake.input_missing", "the bundle or the environment of this job is gone; order it again"
        )
    out = order.run_dir / OUT
    bake_light(inputs / "bundle", out, request_of(order.start, maps[0]), order.reporter)
    return out


def request_of(start: worker_pb2.StartResponse, environment: Path) -> BakeRequest:
    """Return the request in an order; raises ConfigError for settings that cannot be read."""
    settings = start.params
    ratio = None
    if settings.get("albedo_ratio"):
        parts = [_number("albedo_ratio", part) for part in settings["albedo_ratio"].split(",")]
        if len(parts) != 3:
            raise ConfigError(f"albedo_ratio must be three positive numbers, got {tuple(parts)}")
        ratio = (parts[0], parts[1], parts[2])
    config = LightBakeConfig()
    if settings.get("steps"):
        config = replace(config, num_steps=round(_number("steps", settings["steps"])))
    return BakeRequest(
        environment=environment,
        name=settings.get("name", "") or settings.get("environment", ""),
        rotate_deg=_number("rotate_deg", settings.get("rotate_deg", "") or "0"),
        albedo_ratio=ratio,
        config=config,
        seed=start.seed,
        device=start.device,
    )


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise ConfigError(f"{name} must be a number, got {text!r}")
    return value
