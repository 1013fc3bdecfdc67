"""Steps, rays and memory of a run, without training or writing anything."""

from typing import Any

from flashcache.config import Config
from flashcache.memory import estimate

GIB = 2**30


def plan(config: Config, *, num_lights: int, device: str) -> dict[str, Any]:
    """Return the sizes of both stages of a run; memory in bytes."""
    stages = {}
    for memory in estimate(config, num_lights=num_lights, device=device or "cpu"):
        settings = config.stage_one if memory.stage == "cache" else config.stage_two
        stages[memory.stage] = {
            "num_steps": settings.num_steps,
            "num_distil_steps": 0 if memory.stage == "cache" else config.stage_two.distil.num_steps,
            "num_rays": settings.num_rays,
            "parameters_bytes": memory.parameters,
            "gradients_bytes": memory.gradients,
            "moments_bytes": memory.moments,
            "activations_bytes": memory.activations,
            "total_bytes": memory.total,
        }
        num_parameters = memory.num_parameters
    return {
        "preset": config.preset,
        "device": device or "cpu",
        "num_parameters": num_parameters,
        "stages": stages,
    }


def as_text(plan: dict[str, Any]) -> str:
    """Return a plan as lines for people."""
    lines = [f"preset {plan['preset']} on {plan['device']}: {plan['num_parameters'] / 1e6:.1f} M parameters"]
    header = ("stage", "steps", "rays", "parameters", "gradients", "moments", "activations", "total [GiB]")
    lines.append("  ".join(f"{name:>11s}" for name in header))
    for name, stage in plan["stages"].items():
        sizes = [
            stage[f"{kind}_bytes"] / GIB
            for kind in ("parameters", "gradients", "moments", "activations", "total")
        ]
        steps = f"{stage['num_steps']}"
        if stage["num_distil_steps"]:
            steps += f"+{stage['num_distil_steps']}"
        cells = [name, steps, f"{stage['num_rays']}", *(f"{size:.2f}" for size in sizes)]
        lines.append("  ".join(f"{cell:>11s}" for cell in cells))
    if any(stage["num_distil_steps"] for stage in plan["stages"].values()):
        lines.append("steps after a + come last and teach the fast cache alone")
    lines.append("estimated from steps of a few rays; the photographs and the libraries come on top")
    return "\n".join(lines)
