"""Derivatives of the radiance that surface points send to cameras, by materials, normals and light.

Directions of incoming light are a fixed pattern of equal solid angles on the hemisphere of each point; the
environment is divided into patches of equal solid angle.
"""

import math
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.color import alpha_from_perceptual_roughness, perceptual_roughness_from_alpha
from flashcache.evaluation.ambiguity import LinearModel
from flashcache.geometry.directions import from_frame, tangent_frame
from flashcache.physical.brdf import Materials, diffuse_brdf_cos, specular_brdf_cos
from flashcache.physical.incident import RadianceSource, RayLimits, SecondaryRays
from flashcache.physical.model import Domain, InverseModel

NUM_DIRECTIONS = 256
PATCH_ROWS, PATCH_COLUMNS = 6, 12
NUM_PATCHES = PATCH_ROWS * PATCH_COLUMNS
SMALLEST_ROUGHNESS = 0.35
"""Sharper reflections are widened to this perceptual roughness, which the pattern of directions resolves."""

STEP = 1e-4
"""Change of a parameter in differences."""


@runtime_checkable
class LitSurface(Protocol):
    """The functions of a trained model that the derivatives need."""

    @property
    def limits(self) -> RayLimits: ...
    @property
    def domain(self) -> Domain: ...
    def materials(self, positions: Tensor) -> Materials: ...
    def environment(self, directions: Tensor, light_index: Tensor) -> Tensor: ...


# Named beside the protocol: from Python 3.12 on, checks of types at run time do not see a module's parts.
Surface = InverseModel | LitSurface


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """Surface points and the photographs that may see them."""

    positions: Float[Tensor, "points 3"]
    normal: Float[Tensor, "points 3"]
    omega_o: Float[Tensor, "points views 3"]
    light_index: Int[Tensor, "points views"]
    visibility: Float[Tensor, "points views"]
    """Share of the point that the camera sees, times how many photographs this one stands for."""

    def select(self, index: slice) -> "SeenPoints":
        """Return some of the points."""
        return SeenPoints(
            self.positions[index],
            self.normal[index],
            self.omega_o[index],
            self.light_index[index],
            self.visibility[index],
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Noise:
    """The error of photographs against the model: one part of fixed size, one relative to the radiance."""

    absolute: float
    relative: float = 0.02
    saturation: float = 1.0
    """Radiance above which a photograph is clipped and provides no information."""

    def weight(self, radiance: Tensor) -> Tensor:
        """Return 1 / variance of observed radiance, zero where it is clipped."""
        variance = self.absolute**2 + (self.relative * radiance) ** 2
        return (radiance < self.saturation) / variance


def hemisphere(like: Tensor, count: int = NUM_DIRECTIONS) -> Float[Tensor, "count 3"]:
    """Return unit directions around +z that each stand for 2 pi / count of solid angle."""
    number = torch.arange(count, dtype=like.dtype, device=like.device) + 0.5
    height = 1.0 - number / count
    azimuth = number * (math.pi * (3.0 - math.sqrt(5.0)))
    ring = (1.0 - height * height).sqrt()
    return torch.stack([ring * azimuth.cos(), ring * azimuth.sin(), height], dim=-1)


def patch_of(directions: Float[Tensor, "*batch 3"]) -> Int[Tensor, "*batch"]:
    """Return the patch of equal solid angle of the environment that a unit direction points at."""
    row = ((0.5 - 0.5 * directions[..., 2]) * PATCH_ROWS).long().clamp(0, PATCH_ROWS - 1)
    turn = torch.atan2(directions[..., 1], directions[..., 0]) / (2.0 * math.pi) + 0.5
    column = (turn * PATCH_COLUMNS).long().clamp(0, PATCH_COLUMNS - 1)
    return row * PATCH_COLUMNS + column


@torch.no_grad()
def linear_model(model: Surface, points: SeenPoints, source: RadianceSource, noise: Noise) -> LinearModel:
    """Return the derivatives of the radiance that every photograph sees at `points`.

    `source` answers what hides the environment and what other surfaces send. Rows are photographs times
    channels; columns of the light are lights times patches times channels.
    """
    num_points, num_views = points.light_index.shape
    incoming = _incoming(model, points, source)
    materials = model.materials(points.positions)
    roughness = perceptual_roughness_from_alpha(materials.alpha).clamp_min(SMALLEST_ROUGHNESS)
    # Log albedo, metalness, roughness and two tilts, in double precision for the differences.
    at = torch.cat(
        [
            materials.albedo.clamp_min(1e-4).log(),
            materials.metalness,
            roughness,
            torch.zeros_like(points.positions[:, :2]),
        ],
        dim=1,
    ).double()

    def by(parameters: list[int]) -> Tensor:
        """Return the derivative of radiance [points, views, 3] by parameters that change together."""
        step = torch.zeros_like(at)
        step[:, parameters] = STEP
        above, below = (_reflectance(points, incoming.omega_i, at + sign * step) for sign in (1.0, -1.0))
        return ((above - below) * incoming.total).sum(dim=2) / (2.0 * STEP)

    value = _reflectance(points, incoming.omega_i, at)
    seen = (value * incoming.total).sum(dim=2)
    near = (value * incoming.near).sum(dim=2)
    # A channel's radiance depends on no other channel's albedo, so that one difference serves all three.
    columns = [by([0, 1, 2]), *(by([parameter]) for parameter in (3, 4, 5, 6))]
    local = seen.new_zeros(num_points, num_views, 3, 10)
    for channel in range(3):
        local[:, :, channel, channel] = columns[0][..., channel]
        local[:, :, channel, 7 + channel] = near[..., channel]
    local[..., 3:7] = torch.stack(columns[1:], dim=-1)
    light = _light_columns(points, value * incoming.sky, incoming.omega_i, model.domain)
    weight = points.visibility[..., None] * noise.weight(seen)
    return LinearModel(local.flatten(1, 2), light, weight.flatten(1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Incoming:
    """Light at the points, multiplied by the solid angle of a direction; axes points, views, directions."""

    omega_i: Tensor
    sky: Tensor
    near: Tensor

    @property
    def total(self) -> Tensor:
        return self.sky + self.near


def _incoming(model: Surface, points: SeenPoints, source: RadianceSource) -> _Incoming:
    num_points, limits = len(points.positions), model.limits
    pattern = hemisphere(points.positions)
    count = len(pattern)
    omega_i = from_frame(pattern[None], points.normal[:, None])
    origins = points.positions + limits.origin_offset * points.normal
    skies, nears = [], []
    # Every point under every light, or, with more turns of the light than photographs per point, under those.
    turned = bool(model.domain.turns)
    slots = points.light_index.T if turned else range(len(model.domain.lights))
    for light in slots:
        index = torch.as_tensor(light, device=omega_i.device).expand(num_points).repeat_interleave(count)
        rays = SecondaryRays(
            origins=origins.repeat_interleave(count, dim=0),
            directions=omega_i.reshape(-1, 3),
            near=limits.near,
            far=limits.far,
            light_index=index,
        )
        answer = source(rays)
        sky = model.environment(rays.directions, index) * (1.0 - answer.opacity)[:, None]
        skies.append(sky.reshape(num_points, count, 3))
        nears.append(answer.near_radiance.reshape(num_points, count, 3))
    solid_angle = 2.0 * math.pi / count
    row = torch.arange(num_points, device=omega_i.device)[:, None]
    column = torch.arange(points.light_index.shape[1])[None] if turned else points.light_index
    chosen = [solid_angle * torch.stack(parts, dim=1)[row, column] for parts in (skies, nears)]
    return _Incoming(omega_i.double(), *(values.double() for values in chosen))


def _reflectance(points: SeenPoints, omega_i: Tensor, parameters: Tensor) -> Tensor:
    """Return reflectance times cosine [points, views, directions, 3]."""
    log_albedo, metalness, roughness, tilt = parameters.split([3, 1, 1, 2], dim=1)
    tangent, bitangent = tangent_frame(points.normal.double())
    normal = points.normal + tilt[:, :1] * tangent + tilt[:, 1:] * bitangent
    normal = normal / normal.norm(dim=-1, keepdim=True)
    alpha = alpha_from_perceptual_roughness(roughness)
    each = Materials(*(values[:, None, None] for values in (log_albedo.exp(), alpha, metalness)))
    towards, facing = omega_i[:, None], normal[:, None, None]
    diffuse = diffuse_brdf_cos(towards, facing, each)
    return diffuse + specular_brdf_cos(points.omega_o[:, :, None].double(), towards, facing, each)


def _light_columns(
    points: SeenPoints, parts: Tensor, omega_i: Tensor, domain: Domain
) -> Float[Tensor, "points rows patches"]:
    """Return the radiance that comes from each patch of each environment that had to be learned.

    Lights that are one environment turned about +z share its patches, and so do the turns of one light.
    """
    if domain.turns:
        return _patches_of_turned_light(points, parts, omega_i, domain)
    num_points, num_views = points.light_index.shape
    turned = domain.rotations_deg
    slots = 1 if turned else len(domain.lights)
    full = parts.new_zeros(num_points, num_views, 3, slots, NUM_PATCHES, 3)
    for light, name in enumerate(domain.lights):
        if name in domain.known_lights or (turned and domain.known_lights):
            continue
        omega = _turned(omega_i, -turned[light]) if turned else omega_i
        member = torch.nn.functional.one_hot(patch_of(omega), NUM_PATCHES).to(parts.dtype)
        lit = (points.light_index == light).to(parts.dtype)[..., None, None]
        by_patch = torch.einsum("pvdc,pdb->pvcb", lit * parts, member)
        for channel in range(3):
            full[:, :, channel, 0 if turned else light, :, channel] += by_patch[:, :, channel]
    return full.reshape(num_points, num_views * 3, -1)


def _patches_of_turned_light(
    points: SeenPoints, parts: Tensor, omega_i: Tensor, domain: Domain
) -> Float[Tensor, "points rows patches"]:
    """Return the radiance from each patch of the one environment, which has a turn per photograph."""
    num_points, num_views = points.light_index.shape
    full = parts.new_zeros(num_points, num_views, 3, NUM_PATCHES, 3)
    if not domain.known_lights:
        turns = omega_i.new_tensor(domain.turns).reshape(-1, 3, 3)[points.light_index]
        omega = torch.einsum("pvij,pdj->pvdi", turns, omega_i)
        member = torch.nn.functional.one_hot(patch_of(omega), NUM_PATCHES).to(parts.dtype)
        by_patch = torch.einsum("pvdc,pvdb->pvcb", parts, member)
        for channel in range(3):
            full[:, :, channel, :, channel] = by_patch[:, :, channel]
    return full.reshape(num_points, num_views * 3, -1)


def _turned(directions: Tensor, degrees: float) -> Tensor:
    """Return directions turned about +z, counter-clockwise from above."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x, y, z = directions.unbind(dim=-1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y, z], dim=-1)
