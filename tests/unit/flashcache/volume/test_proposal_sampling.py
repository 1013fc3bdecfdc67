import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.geometry.rays import Rays
from flashcache.volume.proposal_sampling import DistanceCurve, SampleCounts, midpoints, sample_rays

LADDER = DistanceCurve(power=-1.5, premultiplier=2.0)
COUNTS = SampleCounts(first=32, second=32, final=16)
NEAR, FAR, WALL = 1.0, 5.0, 3.2


def rays(count: int = 4) -> Rays:
    origins = torch.zeros(count, 3)
    directions = torch.nn.functional.normalize(torch.randn(count, 3), dim=-1)
    return Rays(origins, directions, torch.full((count,), NEAR), torch.full((count,), FAR))


def wall(positions: torch.Tensor) -> torch.Tensor:
    return 200.0 * (positions.norm(dim=-1) > WALL).to(positions.dtype)


def sampled(generator: torch.Generator | None = None, exponent: float = 1.0):
    torch.manual_seed(0)
    return sample_rays(rays(), (wall, wall), COUNTS, DistanceCurve(), exponent=exponent, generator=generator)


@pytest.mark.parametrize("curve", [DistanceCurve(), LADDER, DistanceCurve(power=-0.25, premultiplier=100.0)])
def test_normalised_distance_is_the_inverse_of_distance(curve: DistanceCurve):
    near, far = torch.tensor(0.05, dtype=torch.float64), torch.tensor(2.0, dtype=torch.float64)
    s = torch.linspace(0.0, 1.0, 11, dtype=torch.float64)
    distance = curve.distance(s, near, far)
    torch.testing.assert_close(distance[[0, -1]], torch.stack([near, far]))
    torch.testing.assert_close(curve.normalised(distance, near, far), s)


def test_the_ladder_puts_more_samples_near_the_start():
    near, far = torch.tensor(0.05), torch.tensor(2.0)
    steps = LADDER.distance(torch.linspace(0.0, 1.0, 9), near, far).diff()
    assert (steps.diff() > 0.0).all()


def test_final_samples_gather_at_a_wall_that_proposals_have_seen():
    samples = sampled()
    at_wall = (midpoints(samples.distances) - WALL).abs() < 0.2
    assert at_wall.float().mean() > 0.75


def test_with_exponent_zero_the_wall_is_ignored():
    spread = sampled(exponent=0.0).distances.diff(dim=-1)
    assert (spread - spread.mean()).abs().max() < 0.02


def test_positions_lie_on_their_rays_between_the_ends():
    samples = sampled(torch.Generator().manual_seed(1))
    distance = samples.positions.norm(dim=-1)
    torch.testing.assert_close(distance, midpoints(samples.distances))
    assert samples.distances.min() >= NEAR
    assert samples.distances.max() <= FAR


def test_without_a_generator_samples_are_repeatable_and_with_one_they_move():
    assert torch.equal(sampled().distances, sampled().distances)
    assert not torch.equal(sampled(torch.Generator().manual_seed(1)).distances, sampled().distances)


def test_no_gradient_crosses_a_round():
    scale = torch.tensor(1.0, requires_grad=True)

    def density(positions: torch.Tensor) -> torch.Tensor:
        return scale * wall(positions)

    samples = sample_rays(rays(), (density, density), COUNTS, DistanceCurve(), exponent=1.0, generator=None)
    assert not samples.distances.requires_grad
    assert all(proposal.weights.requires_grad for proposal in samples.proposals)


def test_a_round_of_one_sample_is_refused():
    with pytest.raises(ConfigError, match="at least 2"):
        SampleCounts(final=1)
