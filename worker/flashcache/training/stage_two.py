"""Stage two: materials, light, fast cache and sampler learn together with the NeRF cache (supplement 2.4).

Names: pass A and pass B are two independent estimates of the same pixels; with the same samples in both,
the squared error would gain the estimator's variance (supplement Eq. 2).
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from flashcache.config import StageTwoConfig
from flashcache.data.ray_batches import RayBatch, TrainingPixels
from flashcache.parallel.processes import Processes
from flashcache.parallel.ranks import Ranks, divided_among, own_count, whole_count
from flashcache.physical.model import InverseModel
from flashcache.randomness import generator_for
from flashcache.rows import fixed_shapes
from flashcache.training.cuda_graphs import Capture, Graphs
from flashcache.training.distil import Distillation
from flashcache.training.joint_losses import (
    Terms,
    cache_terms,
    consistency_terms,
    covered,
    decay_terms,
    environment_terms,
    material_terms,
    metalness_terms,
    physical_loss,
    secondary_terms,
)
from flashcache.training.optimiser import (
    Number,
    Rates,
    StepRecord,
    Steps,
    build_optimiser,
    parameter_groups,
    set_rates,
    train_only,
)
from flashcache.training.parts import Parts, mean_terms, numbers
from flashcache.training.passes import shade
from flashcache.training.schedule import rate_factor
from flashcache.training.stage_one import PSNR, masked_psnr
from flashcache.volume.quadrature import composite

STAGE = "joint"


class JointPhase(NamedTuple):
    """What is computed in a step of stage two."""

    with_normals: bool
    with_second: bool
    """Whether the warm-up of the fast cache is over: two passes, and all losses."""
    with_gloss: bool
    """Whether GGX width and metalness learn from photographs."""


@dataclass
class JointLosses:
    """The losses of a part of a batch in stage two; `flashcache.training.parts.Losses`."""

    config: StageTwoConfig
    seed: int

    def __call__(
        self, model: InverseModel, batch: RayBatch, step: int, part: int, count: int
    ) -> tuple[Tensor, tuple[dict[str, Number], Tensor]]:
        """Return the loss of one part of a batch, its terms, and its physical picture over black."""
        terms, picture = self.terms(model, batch, step, part)
        return torch.stack(list(terms.values())).sum(), (numbers(terms), picture.detach())

    def phase(self, step: int) -> JointPhase:
        """Return what is computed in a step."""
        config = self.config
        with_normals = config.normal_weight > 0.0 and step % config.normal_every == 0
        with_gloss = step >= config.gloss_from * config.num_steps
        return JointPhase(with_normals, step >= config.warmup_steps, with_gloss)

    def terms(self, model: InverseModel, batch: RayBatch, step: int, part: int = 0) -> tuple[Terms, Tensor]:
        """Return the weighted losses of part number `part` of a step's batch by name, and its picture.

        `batch` is the part; the picture is the physical one, over black.
        """
        config = self.config

        def generator_of(purpose: str) -> torch.Generator:
            return generator_for(self.seed, STAGE, step, f"{purpose} {part}", batch.colour.device)

        # 1. Trace the camera rays. Derived normals cost a Jacobian per point: the first rays alone get them.
        generator = generator_of("part")
        with_normals, with_second, with_gloss = self.phase(step)
        num_derived = own_count(round(config.normal_rays * whole_count(len(batch))))
        geometry = model.nerf.trace(
            batch.rays,
            exponent=config.proposal_exponent,
            generator=generator,
            num_derived=num_derived if with_normals else 0,
        )
        # 2. The NeRF cache's own picture is compared with the photographs, so that shape and radiance keep
        # learning while materials do.
        appearance = model.nerf.outgoing(geometry, batch.rays.directions, batch.light_index)
        cache = composite(geometry.weights, appearance.radiance)
        terms = cache_terms(model, config, batch, geometry, cache, generator, with_normals=with_normals)
        terms |= decay_terms(model, config)
        # 3. Pass A: points drawn on each ray are shaded with materials and light, by the control variate.
        # Where both passes carry gradients they are one call; while the fast cache warms up there is one.
        passes = 2 if with_second and config.symmetric else 1
        own = generator_of("passes")
        shaded = shade(model, config, batch, geometry, own, passes=passes, with_gloss=with_gloss)
        picture = shaded.pictures.mean(dim=0)
        if with_second:
            # 4. Pass B gives the second, independent factor of the squared error (supplement Eq. 2).
            if config.symmetric:
                first, second = shaded.pictures
                loss = physical_loss(config, batch, cache, first, second)
                terms["physical"] = loss + physical_loss(config, batch, cache, second, first)
            else:
                (first,) = shaded.pictures
                with torch.no_grad():
                    own = generator_of("pass B")
                    (second,) = shade(model, config, batch, geometry, own, supervise=False).pictures
                picture = 0.5 * (first + second)
                terms["physical"] = physical_loss(config, batch, cache, first, second)
            # 5. What the physical estimates teach the cache, and the priors on materials and environments.
            if config.consistency_weight:
                at_points = geometry.hidden[shaded.index], shaded.estimate, covered(batch, shaded.points)
                terms |= consistency_terms(model, shaded.points, *at_points, config.consistency_weight)
            terms |= material_terms(
                model, config, batch, appearance, shaded, generator, with_gloss=with_gloss
            )
            terms |= environment_terms(model, config, generator)
        terms |= metalness_terms(
            model, config, batch, geometry, shaded, generator, warming_up=not with_second
        )
        # 6. The exact rays of pass A, which the NeRF cache has answered, teach fast cache and light sampler.
        terms |= secondary_terms(model, config, shaded)
        return terms, picture


class StageTwo:
    """The state of stage two; call `step` until `finished`."""

    def __init__(
        self,
        model: InverseModel,
        pixels: TrainingPixels,
        config: StageTwoConfig,
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
        light = Rates(grid=config.environment_rate, network=config.environment_rate)
        groups = [
            (model.materials.shared, config.material_rates),
            *([(model.materials.gloss, config.gloss_rates)] if model.materials.gloss is not None else []),
            (model.environment, light),
            (model.fast, config.fast_rates),
            (model.light_sampler, config.fast_rates),
            (model.nerf.density, config.cache_rates),
            (model.nerf.normals, config.cache_rates),
            (model.nerf.appearance, config.cache_rates),
        ]
        model.nerf.requires_grad_(True)
        model.nerf.proposals.requires_grad_(False)
        self.optimiser = build_optimiser(parameter_groups(groups))
        self.processes, self.ranks = processes, ranks
        self.losses = JointLosses(config, seed)
        self.parts = Parts(model, lambda whole: whole, self.losses, config.num_rays, processes, ranks)
        self.distillation: Distillation | None = None
        on_gpu = pixels.device.type == "cuda"
        self.fixed = (on_gpu or ranks is not None) if fixed is None else fixed
        assert ranks is None or (self.fixed and capture is None), "ranks need fixed shapes and no graphs"
        self.steps = Steps(self.optimiser, masked=self.fixed)
        self.graphs = Graphs(capture)
        self.steps_done = 0
        self.num_skipped = 0

    @property
    def num_steps(self) -> int:
        """Number of joint steps, plus the later ones in which only the fast cache trains."""
        return self.config.num_steps + self.config.distil.num_steps

    @property
    def finished(self) -> bool:
        """Whether all steps have been taken."""
        return self.steps_done >= self.num_steps

    def step(self) -> StepRecord:
        """Take one training step."""
        joint, step = self.config, self.steps_done
        late = step - joint.num_steps
        if late >= 0:
            self._begin_distillation()
        config, of_stage = (joint, step) if late < 0 else (joint.distil, late)
        factor = rate_factor(of_stage, config.num_steps, 0, config.final_rate, config.decay_from)
        set_rates(self.optimiser, factor)
        differentiate = self._differentiate if late < 0 else self._differentiate_fast
        phase = self.losses.phase(step) if late < 0 else "distillation"
        with fixed_shapes(self.fixed), divided_among(self.ranks):
            terms = self.graphs.take(phase, of_stage, differentiate, self.steps)
        psnr = terms.pop(PSNR, 0.0)
        self.steps_done += 1
        skipped = self.steps.count() + (self.steps.read() if self.finished else 0)
        self.num_skipped += skipped
        return StepRecord(
            step=self.steps_done,
            num_steps=self.num_steps,
            loss=sum(terms.values()),
            psnr=psnr,
            terms=terms,
            skipped=skipped,
        )

    def _differentiate(self) -> dict[str, Number]:
        """Set gradients to those of the next step; return its loss terms and the PSNR of its picture."""
        self.optimiser.zero_grad(set_to_none=False)
        batch = self.draw()
        results = self.parts.differentiate(batch, self.steps_done)
        return mean_terms([of_part for of_part, _ in results]) | {
            PSNR: masked_psnr(torch.cat([picture for _, picture in results]), batch)
        }

    def _differentiate_fast(self) -> dict[str, Number]:
        """Set gradients to those of the next of the last steps, in which only the fast cache trains."""
        assert self.distillation is not None
        self.optimiser.zero_grad(set_to_none=False)
        return {"fast": self.distillation.differentiate(self.steps_done - self.config.num_steps)}

    def _begin_distillation(self) -> None:
        """Let only the fast cache train from now on."""
        if self.distillation is None:
            train_only(self.optimiser, self.model.fast)
            self.graphs.forget()
            self.distillation = Distillation(
                self.model,
                self.pixels,
                self.config.distil,
                seed=self.seed,
                processes=self.processes,
                ranks=self.ranks,
            )

    def draw(self) -> RayBatch:
        """Return the batch of the next step."""
        generator = generator_for(self.seed, STAGE, self.steps_done, "rays", self.pixels.device)
        return self.pixels.draw(self.config.num_rays, generator)

    def scale(self) -> dict[str, float]:
        """Return the mean radiance of each light and the mean albedo on the surface.

        The photographs determine their product but not their ratio: a steady drift of the ratio late in
        training shows that the priors no longer constrain it.
        """
        generator = generator_for(self.seed, STAGE, self.steps_done, "scale", self.pixels.device)
        with torch.no_grad():
            batch = self.pixels.draw(256, generator)
            geometry = self.model.nerf.trace(batch.rays, generator=None)
            albedo = self.model.materials(geometry.samples.positions.reshape(-1, 3)).albedo
            seen = composite(geometry.weights, albedo).sum(dim=0) / geometry.weights.sum().clamp_min(1e-6)
            means = {"albedo_mean": float(seen.mean())}
            for index, light in enumerate(self.model.domain.lights):
                image = self.model.environment.image(16, index)
                up = torch.linspace(0.0, torch.pi, 33, device=image.device)[1::2].sin()[:, None, None]
                means[f"environment_mean_{light}"] = float((image * up).mean() / up.mean())
        return means
