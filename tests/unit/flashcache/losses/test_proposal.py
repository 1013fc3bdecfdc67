import torch
from flashcache.losses.proposal import distortion, interlevel
from flashcache.volume.proposal_sampling import RaySamples, Round

EDGES = torch.linspace(0.0, 1.0, 9, dtype=torch.float64)[None]


def peak(index: int, mass: float = 0.9) -> torch.Tensor:
    weights = torch.zeros(1, 8, dtype=torch.float64)
    weights[0, index] = mass
    return weights


def test_a_proposal_that_covers_the_weights_costs_nothing():
    roomy = Round(EDGES, torch.ones(1, 8, dtype=torch.float64))
    assert interlevel(roomy, EDGES, peak(3), 0.01) < 1e-12


def test_a_proposal_that_misses_the_weights_learns_and_the_weights_do_not():
    proposal, final = peak(6).requires_grad_(), peak(3).requires_grad_()
    interlevel(Round(EDGES, proposal), EDGES, final, 0.01).backward()
    assert proposal.grad[0, 3] < 0.0
    assert final.grad is None


def samples(distances: torch.Tensor) -> RaySamples:
    positions = torch.zeros(1, 8, 3, dtype=torch.float64)
    return RaySamples(EDGES, distances, positions, ())


def spread(distances: torch.Tensor, weights: torch.Tensor) -> float:
    """Return the definition: the double sum over pairs, and the term of each interval alone."""
    from flashcache.losses.proposal import DISTORTION_CURVE

    tau = DISTORTION_CURVE.ladder(distances)[0]
    middle, w = 0.5 * (tau[1:] + tau[:-1]), weights[0]
    pairs = sum(w[i] * w[j] * (middle[i] - middle[j]).abs() for i in range(8) for j in range(8))
    return float(pairs + (w.square() * tau.diff()).sum() / 3.0)


def test_distortion_is_the_double_sum_of_its_definition():
    distances = 2.0 + 3.0 * EDGES.square()
    weights = torch.rand(1, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64) / 8.0
    found = distortion(samples(distances), weights)
    assert abs(float(found) - spread(distances, weights)) < 1e-9
