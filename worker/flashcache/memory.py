"""The memory that training needs, estimated from a few rays before anything large is allocated.

Parameters, gradients and Adam's moments are counted. What a step needs besides them grows with the rays: it
is measured on steps of a few rays of the real model and extrapolated. Sizes are in bytes.
"""

import weakref
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from lambent_core.scene import Camera, Scene, View
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from flashcache.config import Config
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import domain_of
from flashcache.kernels import dispatch
from flashcache.physical.estimator import DirectionCounts
from flashcache.physical.model import InverseModel
from flashcache.training.joint_losses import GREY_DIRECTIONS
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo

PROBE_RAYS = {"cache": (512, 1024), "joint": (64, 128)}
"""Numbers of rays at which each stage is measured: enough to outweigh temporaries as large as a table."""
TRACED_SHARE = 0.8
"""Share of the secondary directions that are above the surface once a scene has been learned."""
PAIR_BYTES = 16
"""Bytes that a prior on materials which compares all points keeps for every pair of rays."""
ALLOCATED_SHARE = {"cache": 1.22, "joint": 1.38}
"""Memory that a process takes by the size of its tensors: blocks are rounded, some are kept, and compiled
queries have scratch memory of their own. From `python -m benchmarks memory_model` on a processor."""
LATE = 0.9
"""Share of the training at which it is measured: all losses are on."""


@dataclass(frozen=True, kw_only=True, slots=True)
class MemoryEstimate:
    """The memory that one stage of training needs, in bytes."""

    stage: str
    num_parameters: int
    """Of the whole model, including parameters that this stage does not train."""
    parameters: int
    gradients: int
    moments: int
    """Two per trained parameter, for Adam."""
    activations: int
    """The largest sum of everything else that is alive at once during a step."""

    @property
    def total(self) -> int:
        """Return the sum; a process and a device context need more."""
        return self.parameters + self.gradients + self.moments + self.activations


def estimate(config: Config, *, num_lights: int = 1, device: str = "cpu") -> tuple[MemoryEstimate, ...]:
    """Return the memory that both stages need on a device ("cpu" or "cuda", where kernels need Triton).

    Builds the model in this process's memory and takes a few steps of a few rays on an invented scene: a
    minute at most for the largest preset. The state of the caller's random numbers is kept.
    """
    # The compiled encoders of both devices keep the same tensors; the reference keeps many more. Only a
    # processor has compiled queries.
    choice = "auto"
    if device.startswith("cuda"):
        choice = "encoder" if dispatch.has_gpu_kernels() else "reference"
    threads = torch.get_num_threads()
    with torch.random.fork_rng(devices=[]), dispatch.using(choice):
        torch.set_num_threads(1)  # One thread, so that the meter sees the whole batch as one part.
        try:
            fixed = device.startswith("cuda")
            return tuple(_stage_estimate(config, num_lights, stage, fixed) for stage in PROBE_RAYS)
        finally:
            torch.set_num_threads(threads)


def _stage_estimate(config: Config, num_lights: int, stage: str, fixed: bool) -> MemoryEstimate:
    few, more = PROBE_RAYS[stage]
    probe = _Probe(config, num_lights, fixed)
    first, traced = probe.peak(stage, few)
    second, _ = probe.peak(stage, more)
    per_ray = (second - first) / (more - few)
    num_rays = config.stage_one.num_rays if stage == "cache" else config.stage_two.num_rays
    activations = max(first + per_ray * (num_rays - few), 0.0)
    if stage == "joint":
        clusters = config.stage_two.clusters
        compared = (clusters.weight > 0.0) + (clusters.gloss_weight > 0.0)
        activations += compared * PAIR_BYTES * max(num_rays**2 - more**2, 0)
        # Directions that point into matter are not traced; on random surfaces there are more of them. With
        # fixed shapes all are traced, here too.
        doubled, twice = probe.peak(stage, few, factor=2)
        per_direction = max(doubled - first, 0) / max(twice - traced, 1)
        estimator, points = config.stage_two.estimator, config.stage_two.points_per_ray
        at_once = 2 * points if config.stage_two.symmetric else points
        directions = _total(estimator.fast, estimator.exact, estimator.control_variate) * at_once
        activations += per_direction * max(TRACED_SHARE * directions - traced / few, 0.0) * num_rays
    trained = probe.trained_bytes(stage)
    parameters = sum(p.numel() * p.element_size() for p in probe.model.parameters())
    return MemoryEstimate(
        stage=stage,
        num_parameters=sum(p.numel() for p in probe.model.parameters()),
        parameters=parameters,
        gradients=trained,
        moments=2 * trained,
        activations=round(ALLOCATED_SHARE[stage] * activations),
    )


def _total(fast: DirectionCounts, exact: DirectionCounts, control_variate: str) -> int:
    if control_variate == "off":
        return exact.total
    return fast.total + exact.total


class _Probe:
    """A model of full size in an invented scene."""

    def __init__(self, config: Config, num_lights: int, fixed: bool) -> None:
        # At first no point of a ray weighs too little to be evaluated: that is the peak. An
        # invented scene says nothing of how many secondary rays meet next to nothing either.
        nerf = replace(config.model.nerf, least_weight=0.0, secondary_sure_opacity=0.0)
        config = replace(config, model=replace(config.model, nerf=nerf))
        self.config = config
        self.scene = _invented_scene(config, num_lights)
        environment = replace(config.model.environment, lights="separate")
        torch.manual_seed(0)
        self.model = InverseModel(config.model, domain_of(self.scene, config.space, environment))
        self.pixels = TrainingPixels(self.scene, config.pixels, torch.device("cpu"))
        self.fixed = fixed
        """Steps have fixed shapes, as on a GPU (`flashcache.rows`)."""

    def peak(self, stage: str, num_rays: int, factor: int = 1) -> tuple[int, int]:
        """Return the peak bytes of a step of `num_rays`, and the number of directions traced at once."""
        made = self._stage(stage, num_rays, factor)
        made.step()
        fixed = [*self.model.parameters(), *self.model.buffers()]
        fixed += [p.grad for p in self.model.parameters() if p.grad is not None]
        fixed += tree_leaves(made.optimiser.state_dict())
        traced = [0]

        def count(_module: Any, inputs: tuple[Any, ...]) -> None:
            traced[0] += len(inputs[0])

        hook = self.model.environment.register_forward_pre_hook(count)
        with AllocationMeter(fixed) as meter:
            made.step()
        hook.remove()
        stage_two = self.config.stage_two
        asked_by_prior = GREY_DIRECTIONS if stage_two.grey_weight or stage_two.tint_weight else 0
        # Both passes trace them: at once, or one after the other.
        calls = 1 if self.config.stage_two.symmetric else 2
        return meter.peak, (traced[0] - asked_by_prior) // calls

    def trained_bytes(self, stage: str) -> int:
        """Return the size of the parameters that a stage trains."""
        groups = self._stage(stage, 8, 1).optimiser.param_groups
        return sum(p.numel() * p.element_size() for group in groups for p in group["params"])

    def _stage(self, stage: str, num_rays: int, factor: int) -> StageOne | StageTwo:
        for parameter in self.model.parameters():
            parameter.grad = None
        if stage == "cache":
            one = replace(self.config.stage_one, num_rays=num_rays, normal_every=1)
            made: StageOne | StageTwo = StageOne(self.model, self.pixels, one, seed=0, fixed=self.fixed)
        else:
            two = self.config.stage_two
            estimator = two.estimator
            estimator = replace(
                estimator,
                fast=_multiplied(estimator.fast, factor),
                exact=_multiplied(estimator.exact, factor),
            )
            two = replace(two, num_rays=num_rays, normal_every=1, estimator=estimator)
            made = StageTwo(self.model, self.pixels, two, seed=0, fixed=self.fixed)
        made.steps_done = round(LATE * made.config.num_steps)
        return made


def _multiplied(counts: DirectionCounts, factor: int) -> DirectionCounts:
    return DirectionCounts(
        cosine=factor * counts.cosine, sampler=factor * counts.sampler, specular=factor * counts.specular
    )


class AllocationMeter(TorchDispatchMode):
    """Tracks the storages of all tensors that this thread's operations touch, except `fixed` ones."""

    def __init__(self, fixed: list[Any]) -> None:
        super().__init__()
        tensors = [value for value in fixed if isinstance(value, torch.Tensor)]
        self._fixed = {tensor.untyped_storage().data_ptr() for tensor in tensors}
        self._known: weakref.WeakSet[torch.UntypedStorage] = weakref.WeakSet()
        self.now = 0
        self.peak = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run an operation and record its input and output tensors."""
        result = func(*args, **(kwargs or {}))
        for value in tree_leaves((args, kwargs, result)):
            if isinstance(value, torch.Tensor):
                self._see(value.untyped_storage())
        return result

    def _see(self, storage: torch.UntypedStorage) -> None:
        if storage in self._known or storage.data_ptr() in self._fixed:
            return
        size = storage.nbytes()
        self._known.add(storage)
        self.now += size
        self.peak = max(self.peak, self.now)
        weakref.finalize(storage, self._forget, size)

    def _forget(self, size: int) -> None:
        self.now -= size


def _invented_scene(config: Config, num_lights: int) -> Scene:
    """Return a scene of two cameras with noise as photographs, in a box of the configured size."""
    radius = config.space.contraction_radius or 1.0
    side, lights = 16, tuple(f"light_{index}" for index in range(num_lights))
    noise = np.random.default_rng(0).random((side, side, 4), dtype=np.float32)
    noise[..., 3] = 1.0
    views = []
    for name, sign in (("front", 1.0), ("back", -1.0)):
        pose = np.diag([sign, 1.0, sign, 1.0])
        pose[2, 3] = sign * 2.0 * radius
        camera = Camera(
            width=side,
            height=side,
            focal_x=2.0 * side,
            focal_y=2.0 * side,
            centre_x=side / 2,
            centre_y=side / 2,
            camera_to_world=pose,
        )
        views.append(View(name=name, camera=camera, images=dict.fromkeys(lights, noise)))
    return Scene(
        name="invented",
        lights=lights,
        train=tuple(views),
        test=(),
        bounds_min=(-radius,) * 3,
        bounds_max=(radius,) * 3,
        primary=(0.1 * radius, 4.0 * radius),
        secondary=(0.025 * radius, radius),
        contraction_radius=radius,
    )
