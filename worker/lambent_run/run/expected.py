"""Expected time of the tasks of a run relative to one another, from the sizes in their settings.

Seconds are those of an AMD EPYC (Zen 4) of 2026; only their ratios count, because the time to go is scaled by
the speed that a run has shown so far. The cost of a training step is that of decision 0022: a fixed part, and
work on rays that processes divide. Steps on a GPU are those of an H100 (docs/benchmarks/on-gpu.md).
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flashcache.config import Config

PREPARATION = {"cameras": 90.0, "ingest": 2.0, "masks": 30.0}
"""Seconds of the tasks that depend on the photographs, which are not known yet."""
BEGINNING_S = 3.0
"""Of a training task: reading pictures, starting processes."""
COMPILING_S = 12.0
"""Of the first training task on a GPU: its kernels are compiled."""
GPU_STEPS = {"cache": (2.2, 88.0), "joint": (2.3, 12.6)}
"""Milliseconds of a step on a GPU that do not depend on its size, and how many cores it replaces beyond."""
_MS = 1e-3


def expected_seconds(config: "Config | None", cores: int, *, trains_on_gpu: bool = False) -> dict[str, float]:
    """Return the seconds of every task on `cores` cores, by name; without settings, of the preparation."""
    if config is None:
        return PREPARATION
    training = {"cache": _stage_one(config, cores), "joint": _stage_two(config, cores)}
    if trains_on_gpu:
        steps = {"cache": config.stage_one.num_steps, "joint": config.stage_two.num_steps}
        on_one_core = {"cache": _stage_one(config, 1), "joint": _stage_two(config, 1)}
        for name, (fixed_ms, as_many_cores) in GPU_STEPS.items():
            training[name] = _MS * fixed_ms * steps[name] + on_one_core[name] / as_many_cores
        training["cache"] += COMPILING_S
    return PREPARATION | {
        "cache": BEGINNING_S + training["cache"],
        "joint": BEGINNING_S + training["joint"],
        "polish": _polish(cores),
        "evaluate": _evaluation(config, cores),
        "export": _export(config, cores),
    }


def step_seconds(fixed_ms: float, ray_ms: float, num_rays: int, cores: int) -> float:
    """Return the seconds of a training step with `num_rays` rays of `ray_ms` each."""
    from flashcache.training.parts import num_parts

    parts = num_parts(num_rays, cores)
    # Every further process adds its gradients.
    return _MS * (fixed_ms + 1.5 * (parts - 1) + ray_ms * num_rays / parts)


def _stage_one(config: "Config", cores: int) -> float:
    one, counts = config.stage_one, config.model.nerf.primary_counts
    # The last samples also have normals and radiance.
    samples = counts.first + counts.second + 3 * counts.final
    return one.num_steps * step_seconds(20.0, 1.17 * _MS * samples, one.num_rays, cores)


def _stage_two(config: "Config", cores: int) -> float:
    two = config.stage_two
    exact, fast = two.estimator.exact.total, two.estimator.fast.total
    points = two.points_per_ray * (2 if two.num_steps > two.warmup_steps else 1)
    ray_ms = 0.07 + points * (0.014 * exact + 0.0023 * fast)
    joint = two.num_steps * step_seconds(30.0, ray_ms, two.num_rays, cores)
    point_ms = 0.02 + 0.0065 * two.distil.taught.total
    return joint + two.distil.num_steps * step_seconds(9.0, point_ms, two.distil.num_points, cores)


def _polish(cores: int) -> float:
    """Return the seconds of a polish; the number of surface elements is bounded."""
    return BEGINNING_S + 15.0 + 44.0 / min(cores, 8)


def _evaluation(config: "Config", cores: int) -> float:
    settings = config.evaluation
    pixels = settings.num_views * config.max_side**2
    per_pixel = 8e-6 * settings.antialias**2 + 1e-6 * settings.num_directions * settings.num_repeats
    return 2.0 + (per_pixel * pixels + 5e-3 * settings.uncertainty_points) / min(cores, 4)


def _export(config: "Config", cores: int) -> float:
    settings = config.export
    # Density is evaluated near the surface alone, and charts are cut by one thread.
    cells = min(settings.mesh_resolution, 2 * config.max_side)
    mesh = 3e-4 * cells**2
    transport = 2.5e-5 * settings.transport_size**2
    judged = 1e-6 * settings.judge_samples * config.max_side**2 * 4
    return 15.0 + mesh + (transport + judged) / min(cores, 4)
