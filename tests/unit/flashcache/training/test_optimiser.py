"""Steps of Adam, and those that are left out."""

import pytest
import torch
from flashcache.config import Rates
from flashcache.training.optimiser import (
    Steps,
    build_optimiser,
    parameter_groups,
    take_masked_step,
    take_step,
)


def test_adam_forgets_as_fast_as_the_papers():
    layer = torch.nn.Linear(1, 1, bias=False)
    made = build_optimiser(parameter_groups([(layer, Rates(grid=0.0, network=1e-3))]))
    start = float(layer.weight.detach())
    for gradient in (1.0, 0.0):
        layer.weight.grad.fill_(gradient)
        made.step()
    # Two steps of Adam with beta 0.9 and 0.99, written out; nothing is added to the root.
    second = 0.9 * 0.1 / (1.0 - 0.9**2) / (0.99 * 0.01 / (1.0 - 0.99**2)) ** 0.5
    assert (start - float(layer.weight.detach())) / 1e-3 == pytest.approx(1.0 + second, rel=1e-4)


def layers(device: torch.device) -> tuple[torch.nn.Module, torch.optim.Adam]:
    """Return two groups of parameters on a device, and their optimiser."""
    torch.manual_seed(0)
    made = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.Linear(4, 2)).to(device)
    rates = Rates(grid=0.0, network=1e-2)
    return made, build_optimiser(parameter_groups([(layer, rates) for layer in made]))


def set_gradients(model: torch.nn.Module, step: int, broken: float | None = None) -> None:
    generator = torch.Generator().manual_seed(step)
    for parameter in model.parameters():
        parameter.grad.copy_(torch.randn(parameter.shape, generator=generator))
    if broken is not None:
        model[1].bias.grad[1] = broken


def state(model: torch.nn.Module, optimiser: torch.optim.Adam) -> list[torch.Tensor]:
    """Return copies of all parameters, moments and counts of steps."""
    moments = [value for kept in optimiser.state.values() for value in kept.values()]
    return [value.detach().clone() for value in (*model.parameters(), *moments)]


BROKEN = {2: torch.nan, 4: torch.inf, 5: -torch.inf}
"""A gradient that is not finite, by the number of the step."""


def test_masked_steps_equal_steps_that_the_host_decides_on(device):
    (one, first), (two, second) = layers(device), layers(device)
    for step in range(8):
        for model in (one, two):
            set_gradients(model, step, BROKEN.get(step))
        applied, skipped = take_step(first), take_masked_step(second)
        assert applied == (step not in BROKEN)
        assert float(skipped) == float(step in BROKEN)
        for found, wanted in zip(state(two, second), state(one, first), strict=True):
            assert torch.equal(found, wanted), step


@pytest.mark.parametrize("broken", BROKEN.values())
def test_a_masked_step_with_a_gradient_that_is_not_finite_changes_nothing(device, broken):
    model, optimiser = layers(device)
    set_gradients(model, 0)
    take_masked_step(optimiser)
    before = state(model, optimiser)
    set_gradients(model, 1, broken)
    assert float(take_masked_step(optimiser)) == 1.0
    for found, wanted in zip(state(model, optimiser), before, strict=True):
        assert torch.equal(found, wanted)


def test_large_finite_gradients_are_no_reason_to_skip(device):
    model, optimiser = layers(device)
    set_gradients(model, 0)
    model[0].weight.grad.fill_(3e38)
    assert float(take_masked_step(optimiser)) == 0.0


@pytest.mark.parametrize("masked", [False, True])
def test_skipped_steps_are_counted_once_each(masked, monkeypatch):
    monkeypatch.setattr(Steps, "READ_STEPS", 3)
    model, optimiser = layers(torch.device("cpu"))
    steps = Steps(optimiser, masked=masked)
    counts = []
    for step in range(8):
        set_gradients(model, step, BROKEN.get(step))
        counts.append(steps.take())
    assert counts == ([0, 0, 1, 0, 0, 2, 0, 0] if masked else [0, 0, 1, 0, 1, 1, 0, 0])
    assert steps.read() == steps.read() == 0


def test_a_reading_tells_what_was_skipped_since_the_last(monkeypatch):
    model, optimiser = layers(torch.device("cpu"))
    steps = Steps(optimiser, masked=True)
    for broken in (None, torch.nan, torch.nan):
        set_gradients(model, 0, broken)
        assert steps.take() == 0
    assert [steps.read(), steps.read()] == [2, 0]


def test_a_processor_knows_each_skipped_step_at_once():
    model, optimiser = layers(torch.device("cpu"))
    set_gradients(model, 0, torch.nan)
    assert Steps(optimiser).take() == 1


@pytest.mark.gpu
def test_a_gpu_takes_steps_without_the_host():
    model, optimiser = layers(torch.device("cuda"))
    steps = Steps(optimiser)
    set_gradients(model, 0, torch.nan)
    torch.cuda.set_sync_debug_mode("error")
    try:
        for _ in range(5):
            assert steps.take() == 0
    finally:
        torch.cuda.set_sync_debug_mode("default")
    assert steps.read() == 5
