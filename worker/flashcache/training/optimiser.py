"""Adam over the parts of a model, each with its own peak rate."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.config import Rates
from flashcache.encoding.hash_grid import HashGrid

Number = float | Float[Tensor, ""]


@dataclass(frozen=True, kw_only=True, slots=True)
class StepRecord:
    """The result of a training step: its loss terms and, every few steps, the quality of the picture."""

    step: int
    """Number of steps done, counting this one."""
    num_steps: int
    loss: Number
    psnr: Number
    """Of the batch, dB, on sRGB values inside the mask."""
    terms: Mapping[str, Number]
    skipped: int = 0
    """Steps that are now known to have been skipped because their gradients were not finite: this one, or
    with fixed shapes earlier ones."""

    def read(self) -> "StepRecord":
        """Return the record with plain numbers; waits for a GPU, which a step with fixed shapes does not."""
        terms = {name: float(value) for name, value in self.terms.items()}
        return replace(self, loss=float(self.loss), psnr=float(self.psnr), terms=terms)


def parameter_groups(parts: Iterable[tuple[nn.Module, Rates]]) -> list[dict[str, Any]]:
    """Return optimiser groups with a `peak` rate each, grids and networks apart, without frozen parts."""
    groups: list[dict[str, Any]] = []
    for module, rates in parts:
        grid_modules = [grid for grid in module.modules() if isinstance(grid, HashGrid)]
        for grid in grid_modules:
            grid.in_place_gradient = True  # Training calls nothing but `backward`.
        grids = {id(grid.table) for grid in grid_modules}
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
    on_gpu = groups[0]["params"][0].is_cuda
    if on_gpu:
        for group in groups:
            group["lr"] = torch.tensor(group["lr"], device=group["params"][0].device)
    return torch.optim.Adam(groups, betas=(0.9, 0.99), eps=1e-15, fused=True, capturable=on_gpu)


def set_rates(optimiser: torch.optim.Adam, factor: float) -> None:
    """Set every group's rate to its peak times `factor`.

    On a GPU rates are tensors, which a CUDA graph reads: they are filled, and stay where they are.
    """
    for group in optimiser.param_groups:
        if isinstance(group["lr"], Tensor):
            group["lr"].fill_(group["peak"] * factor)
        else:
            group["lr"] = group["peak"] * factor


def train_only(optimiser: torch.optim.Adam, part: nn.Module) -> None:
    """Let the optimiser step the parameters of `part` alone: it passes over those without a gradient.

    A gradient of zero would not stop the others, for Adam's momentum moves them on.
    """
    moving = {id(parameter) for parameter in part.parameters()}
    for group in optimiser.param_groups:
        for parameter in group["params"]:
            if id(parameter) not in moving:
                parameter.grad = None


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


def largest_gradient(optimiser: torch.optim.Adam) -> Float[Tensor, ""]:
    """Return the largest magnitude of a gradient's element; not finite if any is not."""
    gradients = [p.grad for group in optimiser.param_groups for p in group["params"] if p.grad is not None]
    return torch.nn.utils.get_total_norm(gradients, torch.inf)


def take_masked_step(
    optimiser: torch.optim.Adam, largest: Float[Tensor, ""] | None = None
) -> Float[Tensor, ""]:
    """Take a step with the current gradients; return 1, and change nothing, if one is not finite, else 0.

    The host reads nothing: the device decides. Values are those of `take_step`, except that a sum of finite
    gradients which overflows does not count. `largest` is the `largest_gradient`, where it is known.
    """
    largest = largest_gradient(optimiser) if largest is None else largest
    skipped = torch.isfinite(largest).logical_not().to(torch.float32)
    # Fused Adam leaves everything as it was where this is 1, its count of steps too; as with a GradScaler.
    vars(optimiser).update(grad_scale=None, found_inf=skipped)
    try:
        optimiser.step()
    finally:
        del vars(optimiser)["grad_scale"], vars(optimiser)["found_inf"]
    return skipped


class Steps:
    """The steps of an optimiser, with a count of those that were skipped for a gradient that is not finite.

    On a processor each is known at once. A GPU decides by itself, and the count is read after every
    `READ_STEPS` steps, because a reading waits until the GPU has finished. `apply` is what a CUDA graph
    captures of a step, and `count` what the host does after each.
    """

    READ_STEPS = 100

    def __init__(self, optimiser: torch.optim.Adam, *, masked: bool | None = None) -> None:
        """`masked` lets the device decide; by default on a GPU alone."""
        device = optimiser.param_groups[0]["params"][0].device
        self._optimiser = optimiser
        self._masked = device.type == "cuda" if masked is None else masked
        self._skipped = torch.zeros((), device=device)
        self._unread = 0

    def take(self) -> int:
        """Take a step with the current gradients; return how many more skipped steps are known of."""
        self.apply()
        return self.count()

    def apply(self, largest: Float[Tensor, ""] | None = None) -> None:
        """Take a step with the current gradients; `largest` is the `largest_gradient`, where it is known."""
        if self._masked:
            self._skipped += take_masked_step(self._optimiser, largest)
        elif not take_step(self._optimiser):
            self._skipped += 1.0

    def largest_gradient(self) -> Float[Tensor, ""]:
        """Return the largest magnitude of a gradient's element."""
        return largest_gradient(self._optimiser)

    def count(self) -> int:
        """Return how many more skipped steps are known of, after each step."""
        self._unread += 1
        return self.read() if not self._masked or self._unread >= self.READ_STEPS else 0

    def read(self) -> int:
        """Return the number of skipped steps that were not known of; before a checkpoint, and at the end."""
        if not self._unread:
            return 0
        skipped = int(self._skipped)
        self._skipped.zero_()
        self._unread = 0
        return skipped
