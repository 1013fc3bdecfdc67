"""Spending rays where the picture is still wrong: an error map over the photographs, and draws by it."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.errors import ConfigError


@dataclass(frozen=True, kw_only=True, slots=True)
class RayBudget:
    """Where a stage spends its rays, beyond the paper; off by default."""

    error_share: float = 0.0
    """Share of the rays drawn in proportion to the error seen so far, 0..0.9; 0 leaves the map out."""
    block: int = 64
    """Neighbouring pixels of a row that share one error."""
    memory: float = 0.9
    """Share of a block's error that survives a new measurement, 0..1."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.error_share <= 0.9:
            raise ConfigError(f"budget.error_share must lie in 0..0.9, got {self.error_share}")
        if self.block < 1 or not 0.0 <= self.memory < 1.0:
            raise ConfigError(f"budget needs block >= 1 and 0 <= memory < 1, got {self}")


class ErrorMap:
    """Mean error of blocks of pixels; the state is `error`, everything else follows from the photographs."""

    def __init__(self, budget: RayBudget, candidates: Int[Tensor, " pixels"], num_pixels: int) -> None:
        """Begin with equal errors; `candidates` are the pixels that may be drawn (those near the object)."""
        self.budget = budget
        self.candidates = candidates.sort().values
        blocks = self.candidates.div(budget.block, rounding_mode="floor")
        num_blocks = -(-num_pixels // budget.block)
        self.counts = torch.bincount(blocks, minlength=num_blocks)
        self.first = self.counts.cumsum(0) - self.counts
        self.error = torch.ones(num_blocks, device=candidates.device)

    def draw(self, count: int, generator: torch.Generator) -> Int[Tensor, " rays"]:
        """Return pixels among the candidates, each with a probability in proportion to its block's error."""
        device = self.error.device
        cdf = (self.error * self.counts).double().cumsum(0)
        u = torch.rand(count, generator=generator, device=device, dtype=torch.float64) * cdf[-1]
        block = torch.searchsorted(cdf, u, right=True).clamp_max(len(cdf) - 1)
        inside = torch.rand(count, generator=generator, device=device)
        offset = torch.minimum((inside * self.counts[block]).long(), self.counts[block] - 1)
        return self.candidates[self.first[block] + offset]

    def density(self, pixels: Int[Tensor, " rays"]) -> Float[Tensor, " rays"]:
        """Return the probability with which `draw` takes each candidate, relative to a uniform draw."""
        block = pixels.div(self.budget.block, rounding_mode="floor")
        mean = (self.error * self.counts).sum() / self.counts.sum()
        return self.error[block] / mean

    def record(self, pixels: Int[Tensor, " rays"], error: Float[Tensor, " rays"]) -> None:
        """Take in the errors (not negative) that were found at `pixels`."""
        block = pixels.div(self.budget.block, rounding_mode="floor")
        total = torch.zeros_like(self.error).index_add_(0, block, error)
        number = torch.zeros_like(self.error).index_add_(0, block, torch.ones_like(error))
        seen = number > 0.0
        fresh = total[seen] / number[seen]
        self.error[seen] = self.budget.memory * self.error[seen] + (1.0 - self.budget.memory) * fresh


def draw_by_error(
    pixels: TrainingPixels, errors: ErrorMap, num_rays: int, generator: torch.Generator
) -> RayBatch:
    """Return a batch of which a share is drawn by error, weighted so that mean losses stay the same.

    The weight is the probability of a pixel under `PixelChoice` over its probability here.
    """
    share, choice = errors.budget.error_share, pixels.choice
    by_error = round(num_rays * share)
    index = torch.cat([pixels.choose(num_rays - by_error, generator), errors.draw(by_error, generator)])
    index = index[torch.randperm(num_rays, generator=generator, device=pixels.device)]
    place = torch.searchsorted(errors.candidates, index).clamp_max(len(errors.candidates) - 1)
    inside = (errors.candidates[place] == index).to(errors.error.dtype) / len(errors.candidates)
    usual = choice.inside_share * inside + (1.0 - choice.inside_share) / len(pixels.pixels)
    share = by_error / num_rays
    return pixels.at(index, usual / ((1.0 - share) * usual + share * errors.density(index) * inside))
