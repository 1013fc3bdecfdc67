"""Scaling of gradients."""

import torch
from torch import Tensor


def scale_gradient(values: Tensor, factor: float) -> Tensor:
    """Return `values` unchanged, with gradients multiplied by `factor` on the way back."""
    if factor == 1.0 or not values.requires_grad:
        return values
    if factor == 0.0:
        return values.detach()
    return torch.lerp(values.detach(), values, factor)
