import pytest
import torch
from flashcache.randomness import generator_for
from flashcache.training.schedule import proposal_exponent, ramp, rate_factor

CPU = torch.device("cpu")


def test_a_ramp_is_linear_between_its_ends():
    assert [ramp(x, 0.2, 0.4) for x in (0.0, 0.2, 0.3, 0.4, 1.0)] == pytest.approx([0, 0, 0.5, 1, 1])
    assert ramp(0.5, 0.5, 0.5) == 1.0


def test_the_rate_rises_to_its_peak_and_falls_to_its_end():
    rates = [rate_factor(step, 1000, 100, 0.1, 0.0) for step in range(1000)]
    assert rates[0] < 0.02
    assert 50 < rates.index(max(rates)) < 100
    assert rates[-1] == pytest.approx(0.1, rel=0.01)


def test_the_papers_rate_falls_linearly_from_where_it_is_warm_to_its_end():
    rates = [rate_factor(step, 100_000, 10_000, 0.1, linear=True) for step in (0, 10_000, 55_000, 100_000)]
    assert rates == pytest.approx([0.0, 1.0, 0.55, 0.1], abs=2e-4)


def test_the_rate_halves_per_equal_number_of_steps():
    rates = [rate_factor(step, 100, 0, 0.25, 0.0) for step in (0, 50, 100)]
    assert rates == pytest.approx([1.0, 0.5, 0.25])


def test_the_rate_stays_at_its_peak_until_it_may_fall():
    assert rate_factor(29, 100, 0, 0.1, 0.3) == 1.0
    assert rate_factor(31, 100, 0, 0.1, 0.3) < 1.0


def test_proposal_weights_are_flat_first_and_capped_later():
    assert proposal_exponent(0.0, 0.4) == 0.0
    assert proposal_exponent(1.0, 0.4) == 0.4
    assert proposal_exponent(0.1, 1.0) == pytest.approx(1.0 / 1.9)


def test_generators_differ_by_every_argument_and_by_nothing_else():
    def first(*arguments) -> float:
        return float(torch.rand(1, generator=generator_for(*arguments, CPU)))

    base = first(0, "joint", 3, "pass A")
    others = [(1, "joint", 3, "pass A"), (0, "cache", 3, "pass A"), (0, "joint", 4, "pass A")]
    others.append((0, "joint", 3, "pass B"))
    assert base == first(0, "joint", 3, "pass A")
    assert len({base, *(first(*other) for other in others)}) == 5
