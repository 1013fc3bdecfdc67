"""Normals of surface elements from where they lie, and small turns of them."""

import numpy as np
import torch
from jaxtyping import Float
from scipy.spatial import cKDTree
from torch import Tensor

from flashcache.geometry.directions import normalize
from flashcache.polish.elements import Elements

REACH = 4.0
"""Distance of the elements that make a plane, in sizes of an element."""
MOST = 40
"""Elements of a plane."""
LEAST = 8
ALIKE = 0.2
"""Cosine between predicted normals from which elements belong to one plane."""


def plane_normals(elements: Elements, reach: float = REACH, most: int = MOST) -> Float[Tensor, "elements 3"]:
    """Return the normals of planes through each element and those around it, facing as predicted ones do.

    Of at most `most` elements, as near as `reach` sizes of an element. The predicted normal is kept where
    there are too few.
    """
    predicted, places = elements.normal.numpy(), elements.positions.numpy()
    reach = reach * elements.size
    distance, near = cKDTree(places).query(places, min(most, len(places)), distance_upper_bound=reach)
    within = np.isfinite(distance)
    near, distance = np.where(within, near, 0), np.where(within, distance, reach)
    alike = (predicted[near] * predicted[:, None]).sum(axis=-1) > ALIKE
    weight = np.exp(-0.5 * (2.0 * distance / reach) ** 2) * within * alike
    middle = (weight[..., None] * places[near]).sum(axis=1) / weight.sum(axis=1, keepdims=True)
    offset = places[near] - middle[:, None]
    moments = np.einsum("nk,nki,nkj->nij", weight, offset, offset)
    normal = np.linalg.eigh(moments)[1][:, :, 0]
    normal *= np.where((normal * predicted).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
    few = (weight > 0.0).sum(axis=1) < LEAST
    normal[few] = predicted[few]
    return torch.from_numpy(normal).float()


def tilted(
    normal: Float[Tensor, "elements 3"], moves: Float[Tensor, "elements 2"]
) -> Float[Tensor, "elements 3"]:
    """Return unit normals moved in their tangent planes, in the frame of `compiled_fit`."""
    x, y, z = normal.unbind(dim=-1)
    sign = torch.where(z >= 0.0, 1.0, -1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    tangent = torch.stack([1.0 + sign * x * x * a, sign * b, -sign * x], dim=-1)
    bitangent = torch.stack([b, sign + y * y * a, -y], dim=-1)
    return normalize(normal + moves[:, :1] * tangent + moves[:, 1:] * bitangent)
