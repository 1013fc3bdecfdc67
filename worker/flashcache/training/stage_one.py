"""Stage one: the NeRF cache learns to reproduce the photographs (supplement 2.4)."""

import torch
from torch import Tensor

from flashcache.color import srgb_from_linear
from flashcache.config import StageOneConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.parallel.processes import Processes
from flashcache.parallel.ranks import Ranks, divided_among, mean_of_ranks, sum_of_ranks
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for
from flashcache.rows import Rows, fixed_shapes, mean_where
from flashcache.training.cache_losses import STAGE, CacheLosses
from flashcache.training.cuda_graphs import Capture, Graphs
from flashcache.training.occupied import keep_filled
from flashcache.training.optimiser import (
    Number,
    StepRecord,
    Steps,
    build_optimiser,
    parameter_groups,
    set_rates,
)
from flashcache.training.parts import Parts, mean_terms
from flashcache.training.schedule import rate_factor

PSNR = "psnr"


class StageOne:
    """The state of stage one; call `step` until `finished`."""

    def __init__(
        self,
        model: InverseModel,
        pixels: TrainingPixels,
        config: StageOneConfig,
        *,
        seed: int,
        processes: Processes | None = None,
        fixed: bool | None = None,
        capture: Capture | None = None,
        ranks: Ranks | None = None,
    ) -> None:
        """`processes` share the work of a step; without them it is done by this one.

        With `fixed` shapes (`flashcache.rows`), by default on a GPU alone, the host never waits for a step,
        and `capture` takes steps by CUDA graphs. With `ranks`, shapes are fixed, and each of them takes the
        same steps.
        """
        self.model, self.pixels, self.config, self.seed = model, pixels, config, seed
        self.optimiser = build_optimiser(parameter_groups([(model.nerf, config.rates)]))
        scene = pixels.scene
        self.losses = CacheLosses(config, seed, (scene.bounds_min, scene.bounds_max))
        self.ranks = ranks
        self.parts = Parts(model, lambda whole: whole.nerf, self.losses, config.num_rays, processes, ranks)
        on_gpu = pixels.device.type == "cuda"
        self.fixed = (on_gpu or ranks is not None) if fixed is None else fixed
        assert ranks is None or (self.fixed and capture is None), "ranks need fixed shapes and no graphs"
        self.steps = Steps(self.optimiser, masked=self.fixed)
        self.graphs = Graphs(capture)
        self.steps_done = 0
        self.num_skipped = 0

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.steps_done >= self.config.num_steps

    def step(self) -> StepRecord:
        """Take one training step; after the last one, what is empty is ruled out."""
        config, step = self.config, self.steps_done
        linear = config.decay == "linear"
        factor = rate_factor(step, config.num_steps, config.warmup_steps, config.final_rate, linear=linear)
        set_rates(self.optimiser, factor)
        if self.fixed:
            self.losses.prepare(step, self.pixels.device)
        with fixed_shapes(self.fixed), divided_among(self.ranks):
            terms = self.graphs.take(self.losses.phase(step), step, self._differentiate, self.steps)
        psnr = terms.pop(PSNR)
        self.steps_done += 1
        skipped = self.steps.count()
        if self.finished:
            skipped += self.steps.read()
            keep_filled(self.model.nerf)
        self.num_skipped += skipped
        return StepRecord(
            step=self.steps_done,
            num_steps=config.num_steps,
            loss=sum(terms.values()),
            psnr=psnr,
            terms=terms,
            skipped=skipped,
        )

    def _differentiate(self) -> dict[str, Number]:
        """Set gradients to those of the next step; return its loss terms and the PSNR of its picture."""
        step = self.steps_done
        generator = generator_for(self.seed, STAGE, step, "rays", self.pixels.device)
        batch = self.pixels.draw(self.config.num_rays, generator)
        self.optimiser.zero_grad(set_to_none=False)
        results = self.parts.differentiate(batch, step)
        return mean_terms([of_part for of_part, _ in results]) | {
            PSNR: masked_psnr(torch.cat([picture for _, picture in results]), batch)
        }


def masked_psnr(premultiplied: Tensor, batch: RayBatch) -> Number:
    """Return the PSNR [dB] of a batch on sRGB values, over pixels that the object covers; 0 without any.

    With fixed shapes it is a tensor, which the host has not waited for.
    """
    covered = Rows.where(batch.coverage > 0.5)
    wanted = srgb_from_linear(covered.of(batch.colour * batch.coverage[:, None]))
    squared = (srgb_from_linear(covered.of(premultiplied).clamp(0.0, 1.0)) - wanted).square()
    if covered.counted is None:
        return float(-10.0 * torch.log10(squared.mean().clamp_min(1e-10))) if len(squared) else 0.0
    mean = mean_of_ranks(mean_where(squared, covered.counted))
    seen = sum_of_ranks(covered.counted.sum()) > 0
    return -10.0 * torch.log10(mean.clamp_min(1e-10)) * seen
