"""Surface elements of a sphere of one material under a known sky, observed without noise.

Radiance is a sum over a fine grid of directions with the reflectance model of training, and shares no code
with the compiled fit.
"""

import math

import torch
from flashcache.fields.materials import Materials
from flashcache.geometry.directions import environment_directions, environment_solid_angles, normalize
from flashcache.geometry.octahedron import octahedral_directions
from flashcache.physical.brdf import brdf_cos
from flashcache.polish.elements import Elements
from flashcache.polish.incoming import SIDE, IncomingTables
from flashcache.polish.polish import FINER
from torch import Tensor

RADIUS = 0.5
SUN = normalize(torch.tensor([0.5, -0.4, 0.75]))
ROWS = 96


def radiance(directions: Tensor) -> Tensor:
    """Return the sky: a warm sun and a fill light over a blue gradient, [n, 3]."""
    sun = torch.exp(60.0 * ((directions @ SUN) - 1.0))[:, None] * torch.tensor([9.0, 8.0, 6.0])
    other = torch.exp(25.0 * ((directions @ normalize(torch.tensor([-0.9, 0.3, 0.2]))) - 1.0))
    up = (0.5 + 0.5 * directions[:, 2:3]) * torch.tensor([0.3, 0.4, 0.6]) + 0.1
    return sun + other[:, None] * torch.tensor([1.0, 2.0, 2.5]) + up


def sky_picture() -> Tensor:
    """Return the sky in the square of the polish, [1, cells, 3]."""
    return radiance(octahedral_directions(SIDE * FINER))[None]


def quadrature(normal: Tensor, omega_o: Tensor, materials: Materials, light=radiance) -> Tensor:
    """Return reflected radiance [n, 3] by summing over all directions."""
    directions = environment_directions(ROWS, 2 * ROWS).reshape(-1, 3)
    angles = environment_solid_angles(ROWS, 2 * ROWS)[:, None].expand(ROWS, 2 * ROWS).reshape(-1)
    arriving = light(directions) * angles[:, None]
    found = []
    for n, o, a, w, m in zip(
        normal, omega_o, materials.albedo, materials.alpha, materials.metalness, strict=True
    ):
        diffuse, specular = brdf_cos(o[None], directions, n[None], Materials(a[None], w[None], m[None]))
        found.append(((diffuse + specular) * arriving).sum(dim=0))
    return torch.stack(found)


def sphere_elements(
    albedo: tuple[float, float, float], alpha: float, metalness: float, *, count: int = 200, views: int = 8
) -> Elements:
    """Return elements evenly over the sphere, each seen by those of `views` cameras that face it."""
    number = torch.arange(count, dtype=torch.float32) + 0.5
    z = 1.0 - 2.0 * number / count
    azimuth = number * math.pi * (3.0 - math.sqrt(5.0))
    flat = (1.0 - z * z).sqrt()
    normal = torch.stack([flat * azimuth.cos(), flat * azimuth.sin(), z], dim=-1)
    turn = 2.0 * math.pi * torch.arange(views) / views
    height = torch.where(torch.arange(views) % 2 == 0, 0.5, -0.3)
    eyes = normalize(torch.stack([turn.cos(), turn.sin(), height], dim=-1))
    seen = (normal @ eyes.T) > 0.3
    enough = seen.sum(dim=1) >= 2
    normal, seen = normal[enough], seen[enough]
    element, eye = seen.nonzero(as_tuple=True)
    total = len(element)
    materials = Materials(
        torch.tensor(albedo).expand(total, 3),
        torch.full((total, 1), alpha),
        torch.full((total, 1), metalness),
    )
    colour = quadrature(normal[element], eyes[eye], materials)
    return Elements(
        positions=RADIUS * normal,
        normal=normal,
        size=0.08,
        first=torch.nn.functional.pad(seen.sum(dim=1).cumsum(0), (1, 0)),
        points=RADIUS * normal[element],
        omega_o=eyes[eye],
        colour=colour,
        clipped=torch.zeros(total, 3, dtype=torch.bool),
        detail=torch.ones(total, 3),
        light=torch.zeros(total, dtype=torch.long),
        pixel=torch.arange(total),
        photograph=eye,
        places=RADIUS * normal[element][:, None].expand(-1, 4, 3),
        rest=torch.zeros(0, 4, 3),
    )


def open_tables(count: int) -> IncomingTables:
    """Return tables of elements that nothing hides the sky from."""
    cells = SIDE * SIDE
    return IncomingTables(torch.ones(count, cells), torch.zeros(1, count, cells, 3))
