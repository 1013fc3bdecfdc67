"""A job of the kind `bake`: reads its order and adapts the bundle that it publishes."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from flashcache.errors import ConfigError
from flashcache.training.light_bake import LightBakeConfig
from lambent_core.errors import UsageError
from lambent_core.reporter import Reporter
from lambent_proto.v1 import job_pb2

from lambent_run.run.bake import BakeRequest, bake_light

OUT = "adapted"


def run_bake(spec: job_pb2.JobSpec, inputs: Path, run_dir: Path, device: str, reporter: Reporter) -> Path:
    """Adapt the bundle in `inputs`/bundle to `inputs`/environment.* and return the new bundle's folder.

    Raises ConfigError for settings that cannot be read, UsageError `bake.input_missing` where the server sent
    no bundle or no environment: they were deleted since.
    """
    maps = sorted(inputs.glob("environment.*"))
    if not maps or not (inputs / "bundle").is_dir():
        raise UsageError(
            "bake.input_missing", "the bundle or the environment of this job is gone; order it again"
        )
    out = run_dir / OUT
    bake_light(inputs / "bundle", out, request_of(spec, maps[0], device), reporter)
    return out


def request_of(spec: job_pb2.JobSpec, environment: Path, device: str) -> BakeRequest:
    """Return the request in an order; raises ConfigError for settings that cannot be read."""
    settings: Mapping[str, str] = spec.params
    ratio = None
    if settings.get("albedo_ratio"):
        ratio = tuple(_number("albedo_ratio", part) for part in settings["albedo_ratio"].split(","))
    config = LightBakeConfig()
    if settings.get("steps"):
        config = replace(config, num_steps=round(_number("steps", settings["steps"])))
    return BakeRequest(
        environment=environment,
        name=settings.get("name", "") or settings.get("environment", ""),
        rotate_deg=_number("rotate_deg", settings.get("rotate_deg", "") or "0"),
        albedo_ratio=ratio,
        config=config,
        seed=spec.seed,
        device=device,
    )


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < 1e9:
        raise ConfigError(f"{name} must be a number, got {text!r}")
    return value
