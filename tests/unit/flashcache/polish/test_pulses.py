"""A polish pulses every few seconds: for a stop, and for a preview."""

import copy
from itertools import groupby

import pytest
import torch
from flashcache.data.ray_batches import PixelChoice, TrainingPixels
from flashcache.polish import polish as whole
from flashcache.polish import write
from flashcache.polish.polish import polish
from support.polished_ball import pictures_of_the_model, trained_ball


@pytest.fixture
def scene():
    return pictures_of_the_model()


@pytest.fixture
def model():
    return trained_ball()


def test_nothing_that_takes_long_is_done_without_a_pulse_before_and_after(scene, model, monkeypatch):
    """A preview or a stop waits for one of them at most."""
    happened: list[str] = []

    def told(module, name: str) -> None:
        work = getattr(module, name)

        def record(*given, **named):
            found = work(*given, **named)
            happened.append(name)
            return found

        monkeypatch.setattr(module, name, record)

    # Most of the time of a polish: docs/benchmarks/materials.md.
    for name in ("choose", "fit_light", "incoming_tables", "confidence_of", "gate"):
        told(whole, name)
    told(torch.optim.Adam, "step")

    def pulse(*_) -> None:
        happened.append("pulse")

    pixels = TrainingPixels(scene, PixelChoice(clipped="at_least"), torch.device("cpu"))
    polish(copy.deepcopy(model), pixels, seed=0, advance=pulse, pulse=pulse)
    between = [list(group) for is_pulse, group in groupby(happened, "pulse".__eq__) if not is_pulse]
    assert sum(len(group) for group in between if "choose" in group) == whole.ROUNDS
    for group in between:
        assert len(group) == 1 or set(group) == {"step"}
        assert len(group) <= write.PULSE_STEPS
