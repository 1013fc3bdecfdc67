"""One shaded point with light known in closed form, repeated: every row is an independent estimate."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from flashcache.physical.brdf import Materials, brdf_cos
from flashcache.physical.incident import Incident, RayLimits, SecondaryRays
from flashcache.physical.light_sampler import VmfMixture
from flashcache.physical.shading import ShadingPoints
from support.sphere import frame_with_axis, sphere_quadrature

LIMITS = RayLimits(near=0.05, far=2.0)


def unit(*components: float) -> torch.Tensor:
    """Return a unit vector, float64."""
    vector = torch.tensor(components, dtype=torch.float64)
    return vector / vector.norm()


def unoccluded(rays: SecondaryRays) -> Incident:
    """Return the answer of empty space: no near radiance, no occlusion."""
    near = torch.zeros_like(rays.origins)
    return Incident(near, near[:, 0], torch.full_like(near[:, 0], rays.far))


NORMAL = unit(0.3, -0.2, 0.9)
OMEGA_O = unit(0.6, 0.3, 0.8)


def environment(directions: torch.Tensor, light_index: torch.Tensor | None = None) -> torch.Tensor:
    """Return smooth coloured light from above."""
    z = directions[:, 2:3]
    colour = directions.new_tensor([1.0, 0.7, 0.4])
    return (0.2 + (1.0 + z) ** 2) * colour + 0.3 * directions.abs()


def nerf(rays: SecondaryRays) -> Incident:
    """Return a smooth half-transparent neighbour towards +x."""
    opacity = 0.5 + 0.45 * torch.tanh(3.0 * rays.directions[:, 0])
    colour = 0.3 + 0.2 * rays.directions.square() + 0.1 * rays.origins.abs()
    return Incident(opacity[:, None] * colour, opacity, 0.5 + opacity)


def blurred(rays: SecondaryRays) -> Incident:
    """Return what a fast cache would: nearly the same as `nerf`."""
    answer = nerf(rays)
    return Incident(1.1 * answer.near_radiance, 0.95 * answer.opacity, answer.distance)


def peaked_mixture(points: int, axis: torch.Tensor, kappa: float = 20.0, share: float = 0.8) -> VmfMixture:
    """Return two lobes at every point: one about `axis`, and one that is nearly uniform."""
    means = torch.stack([axis, unit(0.0, 0.0, 1.0)]).expand(points, 2, 3).contiguous()
    concentration = torch.tensor([kappa, 0.1], dtype=torch.float64).expand(points, 2).contiguous()
    amplitude = torch.tensor([share, 1.0 - share], dtype=torch.float64).log().expand(points, 2).contiguous()
    return VmfMixture(means, concentration, amplitude)


@dataclass(frozen=True)
class Case:
    """Rows of the same point, and the radiance that each of them should reflect on average."""

    points: ShadingPoints
    materials: Materials

    @property
    def rows(self) -> int:
        """Return the number of independent estimates."""
        return len(self.points.positions)


def case(
    rows: int,
    *,
    alpha: float = 0.4,
    metalness: float = 0.3,
    albedo: tuple[float, float, float] = (0.7, 0.4, 0.2),
    normal: torch.Tensor = NORMAL,
    omega_o: torch.Tensor = OMEGA_O,
) -> Case:
    """Return `rows` copies of one point, float64."""

    def repeat(vector: torch.Tensor) -> torch.Tensor:
        return vector.to(torch.float64).expand(rows, len(vector))

    points = ShadingPoints(
        repeat(unit(0.1, 0.2, 0.3)), repeat(normal), repeat(omega_o), torch.zeros(rows, dtype=torch.long)
    )
    materials = Materials(
        repeat(torch.tensor(albedo)), repeat(torch.tensor([alpha])), repeat(torch.tensor([metalness]))
    )
    return Case(points, materials)


def reflected(
    given: Case,
    source: Callable[[SecondaryRays], Incident] = nerf,
    light: Callable = environment,
    *,
    num_polar: int = 200,
    num_azimuth: int = 400,
) -> dict[str, torch.Tensor]:
    """Return diffuse, specular, rgb and irradiance of the first point by quadrature over its hemisphere.

    Differentiable with respect to the materials and the normal (the hemisphere stays where it was).
    """
    local, weight = sphere_quadrature(num_polar, num_azimuth, lowest=0.0)
    normal = given.points.normal[0]
    directions = frame_with_axis(local, normal.detach())
    count = len(directions)
    origin = (given.points.positions[0] + LIMITS.origin_offset * normal.detach()).expand(count, 3)
    index = torch.zeros(count, dtype=torch.long)
    answer = source(SecondaryRays(origin, directions, LIMITS.near, LIMITS.far, index))
    radiance = answer.near_radiance + (1.0 - answer.opacity)[:, None] * light(directions, index)
    materials = Materials(
        given.materials.albedo[:1], given.materials.alpha[:1], given.materials.metalness[:1]
    )
    diffuse, specular = brdf_cos(given.points.omega_o[:1], directions, normal[None], materials)
    cosine = (directions @ normal).clamp_min(0.0) / math.pi
    weighted = radiance * weight[:, None]
    parts = {
        "diffuse": (diffuse * weighted).sum(dim=0),
        "specular": (specular * weighted).sum(dim=0),
        "irradiance": (cosine[:, None] * weighted).sum(dim=0),
    }
    return parts | {"rgb": parts["diffuse"] + parts["specular"]}
