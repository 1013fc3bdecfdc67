"""Piecewise-constant functions along a ray: sampling them and convolving them.

Letters: `edges` are n+1 increasing positions in [0, 1]; `weights` are the n masses between them.
"""

import torch
from jaxtyping import Float
from torch import Tensor


def sample_centres(
    edges: Float[Tensor, "rays edges"],
    weights: Float[Tensor, "rays samples"],
    num_samples: int,
    jitter: Float[Tensor, "rays 1"] | None,
    exponent: float | Float[Tensor, ""] = 1.0,
) -> Float[Tensor, "rays new"]:
    """Return stratified samples of the density that `weights ** exponent` spreads over `edges`.

    `jitter` in [0, 1) shifts all strata of a ray together; None gives the strata's centres.
    Source: supplement 2.2 (Zip-NeRF's proposal sampling); no gradient flows.
    """
    with torch.no_grad():
        masses = (weights + 1e-5) ** exponent
        cdf = torch.cumsum(masses, dim=-1)
        cdf = torch.nn.functional.pad(cdf / cdf[:, -1:], (1, 0))
        offset = 0.5 if jitter is None else jitter
        strata = torch.arange(num_samples, dtype=cdf.dtype, device=cdf.device)
        u = ((strata + offset) / num_samples).expand(cdf.shape[0], num_samples).contiguous()
        upper = torch.searchsorted(cdf, u, right=True).clamp_(1, cdf.shape[-1] - 1)
        lower = upper - 1
        cdf_lower, cdf_upper = cdf.gather(-1, lower), cdf.gather(-1, upper)
        edge_lower, edge_upper = edges.gather(-1, lower), edges.gather(-1, upper)
        share = ((u - cdf_lower) / (cdf_upper - cdf_lower).clamp_min(1e-12)).clamp_(0.0, 1.0)
        return edge_lower + share * (edge_upper - edge_lower)


def edges_from_centres(centres: Float[Tensor, "rays samples"]) -> Float[Tensor, "rays edges"]:
    """Return interval edges halfway between consecutive centres, inside [0, 1].

    The first and last edge mirror their neighbour about the outermost centres.
    """
    middle = 0.5 * (centres[:, 1:] + centres[:, :-1])
    first = (2.0 * centres[:, :1] - middle[:, :1]).clamp_min(0.0)
    last = (2.0 * centres[:, -1:] - middle[:, -1:]).clamp_max(1.0)
    return torch.cat([first, middle, last], dim=-1)


@torch.no_grad()
def blurred_masses(
    edges: Float[Tensor, "rays edges"],
    weights: Float[Tensor, "rays samples"],
    half_width: float,
    query_edges: Float[Tensor, "rays queries"],
) -> Float[Tensor, "rays intervals"]:
    """Return the masses between `query_edges` of the step function after a box blur.

    The density `weights / length` is convolved with a box of the given half width (units of
    `edges`), which makes it piecewise linear, and integrated exactly between the queries. Not differentiable.
    Source: Zip-NeRF's anti-aliased interlevel loss, in the authors' code.
    """
    height = weights / (edges[:, 1:] - edges[:, :-1]).clamp_min(1e-7)
    jump = torch.diff(torch.nn.functional.pad(height, (1, 1)), dim=-1)
    slope = jump / (2.0 * half_width)
    knots = torch.cat([edges - half_width, edges + half_width], dim=-1)
    slopes = torch.cat([slope, -slope], dim=-1)
    # The integral of a sum of ramps is a sum of squared ramps; in place, for no tensor of a step is larger.
    beyond = (query_edges[:, :, None] - knots[:, None, :]).clamp_min_(0.0).square_()
    cumulative = 0.5 * torch.bmm(beyond, slopes[:, :, None]).squeeze(-1)
    return (cumulative[:, 1:] - cumulative[:, :-1]).clamp_min(0.0)
