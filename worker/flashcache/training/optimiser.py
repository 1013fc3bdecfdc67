"""Adam over the parts of a model, each with its own peak rate."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from flashcache.config import Rates
from flashcache.encoding.hash_grid import HashGrid


@dataclass(frozen=True, kw_only=True, slots=True)
class StepRecord:
    """The result of a training step: its loss terms and, every few steps, the quality of the picture."""

    step: int
    """Number of steps done, counting this one."""
    num_steps: int
    loss: float
    psnr: float
    """Of the batch, dB, on sRGB values inside the mask."""
    terms: Mapping[str, float]
    skipped: bool = False
    """True if the step was skipped because its gradient was not finite."""


def parameter_groups(parts: Iterable[tuple[nn.Module, Rates]]) -> list[dict[str, Any]]:
    """Return optimiser groups with a `peak` rate each, grids and networks apart, without frozen parts."""
    groups: list[dict[str, Any]] = []
    for module, rates in parts:
        found = [grid for grid in module.modules() if isinstance(grid, HashGrid)]
        for grid in found:
            grid.in_place_gradient = True  # Training calls nothing but `backward`.
        grids = {id(grid.table) for grid in found}
        of_grid = [p for p in module.parameters() if id(p) in grids]
        of_network = [p for p in module.parameters() if id(p) not in grids]
        for parameters, peak in ((of_grid, rates.grid), (of_network, rates.network)):
            if parameters and peak > 0.0:
                groups.append({"params": parameters, "lr": peak, "peak": peak})
    return groups


def build_optimiser(groups: list[dict[str, Any]]) -> torch.optim.Adam:
    """Return Adam with the constants of the authors' code, with gradients of zero in place.

    They are there from the first step on, so that sums round the same in a fresh and in a resumed run.
    """
    for group in groups:
        for parameter in group["params"]:
            parameter.grad = torch.zeros_like(parameter)
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True)


def set_rates(optimiser: torch.optim.Adam, factor: float, part: nn.Module | None = None) -> None:
    """Set every group's rate to its peak times `factor`; with a `part`, to zero for all outside of it.

    A gradient of zero alone does not stop a parameter, for Adam's momentum moves it on.
    """
    moving = None if part is None else {id(parameter) for parameter in part.parameters()}
    for group in optimiser.param_groups:
        rests = moving is not None and id(group["params"][0]) not in moving
        group["lr"] = 0.0 if rests else group["peak"] * factor


def apply_gradients(optimiser: torch.optim.Adam, loss: torch.Tensor) -> bool:
    """Back-propagate and take a step; returns False, and changes nothing, if a gradient is not finite."""
    optimiser.zero_grad(set_to_none=False)
    loss.backward()
    return take_step(optimiser)


def take_step(optimiser: torch.optim.Adam) -> bool:
    """Take a step with the current gradients; returns False, and changes nothing, if one is not finite."""
    gradients = [p.grad for group in optimiser.param_groups for p in group["params"] if p.grad is not None]
    # One sum per tensor: a NaN or infinity anywhere makes the total non-finite.
    total = torch.stack([gradient.sum() for gradient in gradients]).sum()
    if not bool(torch.isfinite(total)):
        return False
    optimiser.step()
    return True
