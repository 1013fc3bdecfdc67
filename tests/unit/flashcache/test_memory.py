"""The estimate of memory agrees with what a step really allocates, counted by other means."""

import types
from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache import memory
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import domain_of
from flashcache.kernels import cpu, dispatch
from flashcache.losses.clusters import ClusterConfig
from flashcache.memory import AllocationMeter, MemoryEstimate, estimate
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.lit_sphere import lit_sphere
from torch.profiler import ProfilerActivity, profile

SCENE = lit_sphere(num_views=4)


class _TorchAllocates(types.ModuleType):
    """numpy, except that empty arrays are tensors, which the profiler sees."""

    def __getattr__(self, name: str):
        return getattr(np, name)

    def empty(self, shape, dtype) -> np.ndarray:
        assert dtype is np.float32
        return torch.empty(shape).numpy()


def profiled_peak(step) -> int:
    """Return the largest sum of allocations minus frees during a step, from torch's profiler."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as record:
        step()
    events = [event for event in record.profiler.kineto_results.events() if event.name() == "[memory]"]
    now = largest = 0
    for event in sorted(events, key=lambda event: event.start_ns()):
        now += event.nbytes()
        largest = max(largest, now)
    return largest


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", [True, False])
def test_the_estimate_is_within_thirty_percent_of_the_peak_of_a_larger_step(monkeypatch, symmetric):
    monkeypatch.setattr(cpu, "np", _TorchAllocates("np"))
    config = tiny()
    two = replace(config.stage_two, num_rays=512, symmetric=symmetric, warmup_steps=0, normal_every=1)
    config = replace(config, stage_one=replace(config.stage_one, num_rays=2048), stage_two=two)
    one, joint = estimate(config)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    model = InverseModel(config.model, domain_of(SCENE, config.space, config.model.environment))
    pixels = TrainingPixels(SCENE, config.pixels, torch.device("cpu"))
    for expected, stage in (
        (one, StageOne(model, pixels, replace(config.stage_one, normal_every=1), seed=0)),
        (joint, StageTwo(model, pixels, two, seed=0)),
    ):
        stage.steps_done = round(0.9 * stage.config.num_steps)
        stage.step()
        tensors = expected.activations / memory.ALLOCATED_SHARE[expected.stage]
        assert profiled_peak(stage.step) == pytest.approx(tensors, rel=0.3)
    torch.set_num_threads(threads)


def test_parameters_gradients_and_moments_are_counted_exactly():
    config = tiny()
    model = InverseModel(config.model, domain_of(SCENE, config.space, config.model.environment))
    sizes = {name: 4 * p.numel() for name, p in model.named_parameters()}
    one, two = estimate(config)
    assert one.parameters == two.parameters == sum(sizes.values())
    nerf = sum(size for name, size in sizes.items() if name.startswith("nerf."))
    proposals = sum(size for name, size in sizes.items() if name.startswith("nerf.proposals"))
    assert (one.gradients, one.moments) == (nerf, 2 * nerf)
    assert two.gradients == one.parameters - proposals
    assert one.total == one.parameters + one.gradients + one.moments + one.activations


@pytest.mark.slow
def test_estimating_leaves_random_numbers_and_threads_as_they_were():
    before, threads = torch.get_rng_state(), torch.get_num_threads()
    estimate(tiny(), num_lights=2, device="cuda")
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.get_num_threads() == threads


def test_a_gpu_without_kernels_of_its_own_needs_the_memory_of_the_reference(monkeypatch):
    fixed_on = set()

    def stage_estimate(_config, _num_lights, stage, fixed):
        fixed_on.add((stage, fixed))
        reference = dispatch._backend(torch.device("cpu"), torch.float32) is None
        counts = {"num_parameters": 0, "parameters": 0, "gradients": 0, "moments": 0}
        return MemoryEstimate(stage=stage, activations=2 if reference else 1, **counts)

    monkeypatch.setattr(memory, "_stage_estimate", stage_estimate)
    for installed in (True, False):
        monkeypatch.setattr(dispatch, "_has_triton", lambda installed=installed: installed)
        assert estimate(tiny(), device="cuda")[0].activations == (1 if installed else 2)
        assert estimate(tiny(), device="cpu")[0].activations == 1
    # Steps have fixed shapes on a GPU alone.
    assert fixed_on == {(stage, fixed) for stage in ("cache", "joint") for fixed in (True, False)}


@pytest.mark.long
def test_on_a_gpu_all_directions_are_traced():
    config = tiny()
    (_, here), (_, there) = (estimate(config, device=device) for device in ("cpu", "cuda"))
    assert there.activations > 0.95 * here.activations


@pytest.mark.long
@pytest.mark.slow
def test_more_rays_need_proportionally_more_memory():
    config = tiny()
    double = replace(config, stage_one=replace(config.stage_one, num_rays=2 * config.stage_one.num_rays))
    assert estimate(double)[0].activations == pytest.approx(2 * estimate(config)[0].activations, rel=0.05)


def test_the_meter_counts_what_is_alive_at_once():
    fixed = torch.ones(1000)
    with AllocationMeter([fixed]) as meter:
        first = fixed * 2.0
        del first
        second = fixed + 1.0
        third = second.view(10, 100) + 1.0
    assert meter.peak == 2 * 4000
    assert meter.now == 2 * 4000
    del second, third
    assert meter.now == 0


def test_directions_that_were_not_traced_are_added_at_their_own_price(monkeypatch):
    config = tiny()
    traced_per_ray, per_ray, per_direction, constant = 5, 1000, 70, 12345

    def peak(self, stage, num_rays, factor=1):
        traced = factor * traced_per_ray * num_rays if stage == "joint" else 0
        return constant + per_ray * num_rays + per_direction * traced, traced

    monkeypatch.setattr(memory._Probe, "peak", peak)
    one, two = estimate(config)
    share = memory.ALLOCATED_SHARE["joint"]
    assert one.activations == round(
        memory.ALLOCATED_SHARE["cache"] * (constant + per_ray * config.stage_one.num_rays)
    )
    estimator = config.stage_two.estimator
    # Two passes at once.
    directions = 2 * memory.TRACED_SHARE * (estimator.fast.total + estimator.exact.total)
    rays = config.stage_two.num_rays
    assert two.activations == round(share * (constant + rays * (per_ray + per_direction * directions)))
    two = replace(config.stage_two, num_rays=1024, clusters=ClusterConfig(weight=1.0))
    double = replace(config, stage_two=two)
    pairs = memory.PAIR_BYTES * (1024**2 - memory.PROBE_RAYS["joint"][1] ** 2)
    expected = constant + 1024 * (per_ray + per_direction * directions) + pairs
    assert estimate(double)[1].activations == round(share * expected)
