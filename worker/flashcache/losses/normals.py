"""Losses that tie predicted normals, derived normals and view directions together."""

from jaxtyping import Float
from torch import Tensor

from flashcache.fields.mlp import scale_gradient


def normal_consistency(
    weights: Float[Tensor, "rays samples"],
    predicted: Float[Tensor, "points 3"],
    derived: Float[Tensor, "points 3"],
    weight_gradient: float,
) -> Float[Tensor, ""]:
    """Return the weighted squared distance of predicted and derived normals, as two one-sided terms.

    One term moves the density towards the frozen prediction (its weights pass `weight_gradient` of
    their gradient), the other the prediction towards the frozen derivative. Both normals get the gradient
    of supplement Eq. 6, whose value is half of this one. The split is the authors' practice; their code has
    `1 - cosine` in each term, half of the squared distance.
    """
    # Differs from the paper: weights get a share only (docs/decisions/0019-small-departures.md).
    flat = weights.reshape(-1)
    to_density = (derived - predicted.detach()).square().sum(dim=-1)
    to_prediction = (derived.detach() - predicted).square().sum(dim=-1)
    loss = scale_gradient(flat, weight_gradient) * to_density + flat.detach() * to_prediction
    return loss.sum() / weights.shape[0]


def orientation(
    weights: Float[Tensor, "rays samples"],
    normal: Float[Tensor, "points 3"],
    directions: Float[Tensor, "rays 3"],
) -> Float[Tensor, ""]:
    """Return the penalty on visible normals that face away from the camera (Ref-NeRF Eq. 11)."""
    num_samples = weights.shape[-1]
    cosine = -(normal.reshape(-1, num_samples, 3) * directions[:, None]).sum(dim=-1)
    return (weights * cosine.clamp_max(0.0).square()).sum(dim=-1).mean()
