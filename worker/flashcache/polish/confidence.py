"""The confidence in polished reflectance: the curvature of the polish's cost around what was chosen.

An observation is (1 - m) a d E + F0 A + B, F0 = 0.04 (1 - m) + m a d, as in `flashcache.polish.fit`; a is
albedo, d its detail, m metalness. Its derivatives by a and m have closed forms, that by roughness is a
difference. With the robust weights of the fit,

    covariance = (J' W J + P)^-1,   W = robust weight / variance of the residual

for log albedo (3), metalness and perceptual roughness, where P is the precision of the priors. The light, the
normal and what near surfaces send count as known.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from scipy.spatial import cKDTree
from torch import Tensor

from flashcache.errors import TrainingError
from flashcache.evaluation.ambiguity import Priors
from flashcache.geometry.octahedron import octahedral_directions, octahedral_solid_angles
from flashcache.physical.brdf import DIELECTRIC_F0
from flashcache.polish.elements import Elements
from flashcache.polish.fit import NOISE_FLOOR, OUTLIER
from flashcache.polish.incoming import IncomingTables
from flashcache.polish.known_light import STEP
from flashcache.polish.light import Reflectance, specular_sums
from flashcache.polish.neighbours import Neighbours

FILE = "confidence.safetensors"
DIRECTIONS = 48
"""Half vectors per observation: a derivative needs more of them than a value."""
WIDER = 0.25
"""Relative change of the GGX width between the two sides of the difference and the middle."""
LEAST_ALPHA = 1e-3
POOL = 2
"""Steps along the graph over which the noise level is pooled."""
FITTED = 3
"""Numbers of an element that its own observations were fitted with, mostly: albedo."""
CHUNK = 8192
NEAREST, REACH = 4, 3.0
"""Elements that a look-up averages, and how near they are, in sizes of an element."""


@dataclass(frozen=True, slots=True, eq=False)
class Confidence:
    """Standard deviations of the reflectance at places of the surface, under the fitted light."""

    positions: Float[Tensor, "places 3"]
    """Scene units."""
    size: float
    """Side of an element, scene units."""
    log_albedo: Float[Tensor, "places 3"]
    """Relative standard deviation of albedo."""
    perceptual_roughness: Float[Tensor, " places"]
    metalness: Float[Tensor, " places"]

    def save(self, path: Path) -> None:
        """Write a safetensors file in one move: a reader finds a whole one or none."""
        partial = path.with_name(path.name + ".tmp")
        # Copies: the format refuses tensors that share memory.
        tensors = {name: getattr(self, name).float().clone() for name in self.__slots__ if name != "size"}
        save_file(tensors | {"size": torch.tensor(self.size, dtype=torch.float64)}, partial)
        partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> "Confidence":
        """Return what `save` wrote; raises `TrainingError` when the file is damaged."""
        try:
            stored: dict[str, Any] = load_file(path)
            return cls(**(stored | {"size": float(stored["size"])}))
        except (OSError, KeyError, TypeError, SafetensorError) as error:
            raise TrainingError(
                f"{path} cannot be read ({error!r}); delete it, and maps of uncertainty do without the polish"
            ) from error

    def at(self, positions: Float[Tensor, "places 3"]) -> "Confidence":
        """Return means of the nearest elements by inverse distance; NaN where none is within reach."""
        near = min(NEAREST, len(self.positions))
        reach = REACH * self.size
        distance, index = cKDTree(self.positions.numpy()).query(
            positions.numpy(), [*range(1, near + 1)], distance_upper_bound=reach
        )
        within = np.isfinite(distance)
        weight = torch.from_numpy(np.where(within, 1.0 / (distance + 0.1 * self.size), 0.0)).float()
        # 0 / 0 is the NaN where nothing is near.
        weight = weight / weight.sum(dim=1, keepdim=True)
        index = torch.from_numpy(np.where(within, index, 0))
        return Confidence(
            positions,
            self.size,
            torch.einsum("nk,nkc->nc", weight, self.log_albedo[index]),
            (weight * self.perceptual_roughness[index]).sum(dim=1),
            (weight * self.metalness[index]).sum(dim=1),
        )


def confidence_of(
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    reflectance: Reflectance,
    neighbours: Neighbours,
    priors: Priors | None = None,
) -> Confidence:
    """Return how well the observations of each element determine its `reflectance` under the light `sky`.

    The noise level is what `reflectance` leaves unexplained in an element and those around it, at least a
    step of an 8-bit photograph. Clipped channels do not count. An element without information keeps the
    widths of the `priors`, and so do parameters that its photographs do not depend on.
    """
    predicted, jacobian = derivatives(elements, tables, sky, reflectance)
    element, count = elements.element, len(elements)
    variance_scale = (elements.colour + NOISE_FLOOR).double()
    counted = (~elements.clipped).double()
    squared = counted * (predicted - elements.colour).square() / variance_scale
    robust = counted / (1.0 + squared.sum(dim=1, keepdim=True) / OUTLIER**2)

    def of_elements(values: Tensor) -> Tensor:
        return values.new_zeros(count, *values.shape[1:]).index_add_(0, element, values)

    rows = of_elements(counted.sum(dim=1))
    left = (1.0 - FITTED / rows.clamp_min(1.0)).clamp_min(0.0)
    both = torch.stack([of_elements((robust * squared).sum(dim=1)), of_elements(robust.sum(dim=1)) * left], 1)
    both = neighbours.pooled(both, torch.ones(count, dtype=torch.float64), POOL)
    level = both[:, 0] / both[:, 1].clamp_min(1e-12)
    variance = (level[element, None] * variance_scale).clamp_min(STEP**2)
    weighted = jacobian * (robust / variance)[..., None]
    information = of_elements(jacobian.transpose(1, 2) @ weighted)
    width = (priors or Priors()).local(information)[: jacobian.shape[-1]]
    covariance = torch.linalg.inv(information + torch.diag(width**-2))
    deviation = covariance.diagonal(dim1=1, dim2=2).clamp_min(0.0).sqrt().float()
    return Confidence(elements.positions, elements.size, deviation[:, :3], deviation[:, 4], deviation[:, 3])


def derivatives(
    elements: Elements,
    tables: IncomingTables,
    sky: Float[Tensor, "lights cells 3"],
    reflectance: Reflectance,
) -> tuple[Float[Tensor, "observations 3"], Float[Tensor, "observations 3 5"]]:
    """Return the radiance of every observation and its derivatives, in double precision.

    By log albedo (3), metalness and perceptual roughness, in this order.
    """
    element = elements.element
    metal = reflectance.metalness.double()[element, None]
    albedo = reflectance.albedo.double()[element] * elements.detail
    irradiance = _irradiance(elements, tables, sky, reflectance.normal)
    f0 = DIELECTRIC_F0 * (1.0 - metal) + metal * albedo
    first, second = _specular(elements, tables, sky, reflectance.normal, reflectance.alpha)
    sides = [(reflectance.alpha * factor).clamp(LEAST_ALPHA, 1.0) for factor in (1.0 - WIDER, 1.0 + WIDER)]
    narrow, wide = (
        f0 * part[0] + part[1]
        for part in (_specular(elements, tables, sky, reflectance.normal, alpha) for alpha in sides)
    )
    apart = (sides[1].sqrt() - sides[0].sqrt()).double()[element, None]
    jacobian = torch.zeros(len(element), 3, 5, dtype=torch.float64)
    jacobian[:, :, :3] = torch.diag_embed(albedo * ((1.0 - metal) * irradiance + metal * first))
    jacobian[:, :, 3] = (albedo - DIELECTRIC_F0) * first - albedo * irradiance
    jacobian[:, :, 4] = (wide - narrow) / apart
    return (1.0 - metal) * albedo * irradiance + f0 * first + second, jacobian


def _irradiance(
    elements: Elements, tables: IncomingTables, sky: Tensor, normal: Tensor
) -> Float[Tensor, "observations 3"]:
    """Return the irradiance over pi that each observation's element receives from its light."""
    side = round(tables.clear.shape[1] ** 0.5)
    scale = round(sky.shape[1] ** 0.5) // side
    coarse = sky.reshape(-1, side, scale, side, scale, 3).mean(dim=(2, 4)).reshape(len(sky), -1, 3)
    cosine = (normal @ octahedral_directions(side).T).clamp_min(0.0)
    cosine = cosine * (octahedral_solid_angles(side) / torch.pi)
    received = [
        (cosine * tables.clear) @ far + torch.einsum("nd,ndc->nc", cosine, near)
        for far, near in zip(coarse, tables.near, strict=True)
    ]
    return torch.stack(received)[elements.light, elements.element].double()


def _specular(
    elements: Elements, tables: IncomingTables, sky: Tensor, normal: Tensor, alpha: Tensor
) -> tuple[Float[Tensor, "observations 3"], Float[Tensor, "observations 3"]]:
    """Return the specular integral of each observation: what F0 multiplies, and the rest."""
    picture, light = sky.numpy(), elements.light.numpy()
    side, count = round(sky.shape[1] ** 0.5), len(elements.colour)
    integrals = torch.zeros(2, count, 3, dtype=torch.float64)
    for begin in range(0, count, CHUNK):
        some = slice(begin, begin + CHUNK)
        cells, weights, constant = specular_sums(elements, tables, normal, alpha, side, DIRECTIONS, some)
        arriving = picture[light[some][:, None], cells]
        summed = np.einsum("nkp,nkc->pnc", weights, arriving) + constant.transpose(1, 0, 2)
        integrals[:, some] = torch.from_numpy(summed).double()
    return integrals[0], integrals[1]
