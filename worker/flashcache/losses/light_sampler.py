"""The loss that teaches the light sampler how bright each direction is."""

from jaxtyping import Float
from torch import Tensor

from flashcache.color import loss_curve
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.shading import ExactDirections

PDF_FLOOR = 0.01
"""Smallest density in 1/sr by which a direction's loss is divided."""


def light_sampler_loss(mixture: VmfMixture, exact: ExactDirections) -> Float[Tensor, ""]:
    """Return the squared error of the mixture's amplitude against the length of the incoming radiance.

    Both on the loss scale, as a Monte Carlo integral over the directions above the surface; the radiance is
    that of the NeRF cache plus environment, detached. The halves count equally. The gradient is that of half
    the square. Source: paper, light sampler loss; supplement 2.7.
    """
    target = loss_curve(exact.radiance.norm(dim=-1))
    residual = target - loss_curve(mixture.amplitude(exact.omega_i))
    weight = exact.mis_weight * exact.above / exact.pdf_solid_angle.clamp_min(PDF_FLOOR)
    terms = residual * residual.detach() * weight
    halves = [half for half in terms.tensor_split([exact.num_diffuse], dim=1) if half.numel()]
    return sum((half.mean() for half in halves), start=terms.new_zeros(())) / max(len(halves), 1)
