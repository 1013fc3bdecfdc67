"""Losses on the weights along a ray: their coverage by the proposals, and their spread."""

from jaxtyping import Float
from torch import Tensor

from flashcache.volume.proposal_sampling import DistanceCurve, RaySamples, Round
from flashcache.volume.step_function import blurred_masses

DISTORTION_CURVE = DistanceCurve(power=-0.25, premultiplier=10000.0)


def interlevel(
    proposal: Round,
    final_edges: Float[Tensor, "rays edges"],
    final_weights: Float[Tensor, "rays samples"],
    half_width: float,
) -> Float[Tensor, ""]:
    """Return how much of the blurred final weight a proposal misses, a truncated chi-square.

    `half_width` is the blur in normalised distance. Trains the proposal only.
    Source: Zip-NeRF's interlevel loss, in the authors' code.
    """
    wanted = blurred_masses(final_edges, final_weights, half_width, proposal.edges)
    missing = (wanted - proposal.weights).clamp_min(0.0)
    return (missing.square() / (proposal.weights + 1e-5)).sum(dim=-1).mean()


def distortion(samples: RaySamples, weights: Float[Tensor, "rays samples"]) -> Float[Tensor, ""]:
    """Return the mean spread of the weights along the rays, in a compressed distance.

    `sum_ij w_i w_j |m_i - m_j| + sum_i w_i^2 length_i / 3` with m the interval midpoints.
    Source: Mip-NeRF 360 Eq. 15, in the authors' code.
    """
    edges = DISTORTION_CURVE.ladder(samples.distances)
    middle = 0.5 * (edges[:, 1:] + edges[:, :-1])
    # Sorted midpoints let the double sum be written with running sums.
    mass_before = weights.cumsum(dim=-1) - weights
    moment_before = (weights * middle).cumsum(dim=-1) - weights * middle
    between = 2.0 * (weights * (middle * mass_before - moment_before)).sum(dim=-1)
    within = (weights.square() * (edges[:, 1:] - edges[:, :-1])).sum(dim=-1) / 3.0
    return (between + within).mean()
