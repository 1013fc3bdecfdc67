"""Whole pictures of a trained model: what its surface is, and how it looks under old and new light.

Pictures are numpy float32; radiance is linear Rec. 709, straight (not multiplied by opacity).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray
from torch import Tensor

from flashcache.color import perceptual_roughness_from_alpha
from flashcache.data.scene import Camera
from flashcache.evaluation.relighting import MapLight, relit_radiance
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, control_variate
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from flashcache.randomness import generator_for
from flashcache.volume.proposal_sampling import midpoints
from flashcache.volume.quadrature import composite, draw_points

CHUNK_RAYS = 2048
OPACITY_FLOOR = 1e-3
"""Pixels below this opacity are empty and are not shaded."""


@dataclass(frozen=True, slots=True, eq=False)
class GBuffer:
    """What a camera sees of the surface, as means over the render weights."""

    camera: Camera
    opacity: Float32[ndarray, "height width 1"]
    distance: Float32[ndarray, "height width 1"]
    """From the camera, scene units; 0 where empty."""
    normal: Float32[ndarray, "height width 3"]
    """Unit, world; (0, 0, 1) where empty."""
    albedo: Float32[ndarray, "height width 3"]
    perceptual_roughness: Float32[ndarray, "height width 1"]
    metalness: Float32[ndarray, "height width 1"]
    cache_rgb: Float32[ndarray, "height width 3"]
    """The NeRF cache's picture, premultiplied over black."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A Monte Carlo picture with its noise."""

    rgb: Float32[ndarray, "height width 3"]
    standard_error: Float32[ndarray, "height width 3"]
    """Of `rgb`, from the spread of the estimates."""
    opacity: Float32[ndarray, "height width 1"]


def camera_rays(model: InverseModel, camera: Camera, device: torch.device) -> Rays:
    """Return the rays through all pixel centres, row by row, limited to the scene's box."""
    rows, columns = torch.meshgrid(
        torch.arange(camera.height, device=device) + 0.5,
        torch.arange(camera.width, device=device) + 0.5,
        indexing="ij",
    )
    pose = torch.tensor(camera.camera_to_world, dtype=torch.float32, device=device)
    focal = torch.tensor([camera.focal_x, camera.focal_y], dtype=torch.float32, device=device)
    centre = torch.tensor([camera.centre_x, camera.centre_y], dtype=torch.float32, device=device)
    directions = pixel_directions(columns.reshape(-1), rows.reshape(-1), focal, centre, pose)
    origins = pose[:3, 3].expand_as(directions)
    domain = model.domain
    low, high = origins.new_tensor(domain.bounds_min), origins.new_tensor(domain.bounds_max)
    return clip_to_box(origins, directions, low, high, *domain.primary)


@torch.no_grad()
def render_gbuffer(model: InverseModel, camera: Camera, *, light: int = 0) -> GBuffer:
    """Return the surface as `camera` sees it, deterministic; the cache's picture is under light `light`."""
    device = _device(model)
    rays = camera_rays(model, camera, device)
    parts = []
    for start in range(0, len(rays), CHUNK_RAYS):
        chunk = rays.select(slice(start, start + CHUNK_RAYS))
        part = torch.zeros(len(chunk), 13, device=device)
        part[:, 4] = 1.0
        hit = chunk.far > chunk.near
        if bool(hit.any()):
            part[hit] = _surface(model, chunk.select(hit), light)
        parts.append(part)
    values = torch.cat(parts).reshape(camera.height, camera.width, 13).cpu().numpy()
    opacity, distance, normal, albedo, width, metalness, colour = np.split(
        values, [1, 2, 5, 8, 9, 10], axis=-1
    )
    return GBuffer(camera, opacity, distance, normal, albedo, width, metalness, colour)


def _surface(model: InverseModel, rays: Rays, light: int) -> Float[Tensor, "rays 13"]:
    """Return opacity, distance, normal, albedo, perceptual roughness, metalness and cache colour."""
    geometry = model.nerf.trace(rays, exponent=1.0, generator=None)
    index = torch.full((len(rays),), light, device=rays.origins.device)
    colour = composite(geometry.weights, model.nerf.outgoing(geometry, rays.directions, index).radiance)
    materials = model.materials(geometry.samples.positions.reshape(-1, 3))
    opacity = geometry.opacity[:, None]
    share = 1.0 / opacity.clamp_min(1e-6)
    distance = (geometry.weights * midpoints(geometry.samples.distances)).sum(dim=-1, keepdim=True) * share
    width = composite(geometry.weights, perceptual_roughness_from_alpha(materials.alpha)) * share
    metalness = composite(geometry.weights, materials.metalness) * share
    normal = torch.nn.functional.normalize(composite(geometry.weights, geometry.normal), dim=-1, eps=1e-8)
    up = normal.new_tensor([0.0, 0.0, 1.0])
    empty = opacity < OPACITY_FLOOR
    normal = torch.where(empty, up, normal)
    distance = torch.where(empty, torch.zeros_like(distance), distance)
    albedo = composite(geometry.weights, materials.albedo) * share
    return torch.cat([opacity, distance, normal, albedo, width, metalness, colour], dim=-1)


@torch.no_grad()
def render_physical(
    model: InverseModel,
    camera: Camera,
    *,
    num_directions: int = 64,
    num_repeats: int = 1,
    points_per_ray: int = 4,
    light: int = 0,
    seed: int = 0,
) -> Picture:
    """Return the physically based picture under a training light.

    Every repeat shades `points_per_ray` points drawn anew and spreads `num_directions` secondary rays of the
    fast estimate over them, with a quarter as many for the correction (supplement 2.5).
    """
    per_point = max(4, 4 * (num_directions // (4 * points_per_ray)))
    estimator = EstimatorConfig(
        fast=DirectionCounts.split(per_point),
        exact=DirectionCounts(cosine=1, sampler=1, specular=2),
        stratified=True,
    )

    def shade(points: ShadingPoints, generator: torch.Generator) -> Tensor:
        return control_variate(
            points,
            model.materials(points.positions),
            nerf=model.nerf_source(generator),
            fast=model.fast_source(),
            environment=model.environment,
            mixture=model.light_sampler(points.positions, points.light_index),
            limits=model.limits,
            config=estimator,
            generator=generator,
        ).rgb

    return _monte_carlo(model, camera, shade, num_repeats, points_per_ray, light, seed, "physical")


@torch.no_grad()
def render_relit(
    model: InverseModel,
    camera: Camera,
    environment_map: Float32[ndarray, "rows columns 3"],
    *,
    albedo_ratio: tuple[float, float, float] = (1.0, 1.0, 1.0),
    num_directions: int = 64,
    num_repeats: int = 1,
    points_per_ray: int = 4,
    indirect: bool = True,
    seed: int = 0,
) -> Picture:
    """Return the picture under a new environment (linear, convention of `geometry.directions`).

    Direct light with learned shadows as in the paper's relighting, and with `indirect` one bounce: what
    secondary rays hit is shaded under the new environment with its own materials. `albedo_ratio` multiplies
    the albedo.
    """
    light_map = MapLight.from_image(environment_map, _device(model))
    ratio = torch.tensor(albedo_ratio, dtype=torch.float32, device=_device(model))
    per_point = max(4, num_directions // points_per_ray)

    def shade(points: ShadingPoints, generator: torch.Generator) -> Tensor:
        return relit_radiance(
            model, points, light_map, ratio, num_directions=per_point, indirect=indirect, generator=generator
        )

    return _monte_carlo(model, camera, shade, num_repeats, points_per_ray, 0, seed, "relit")


def _monte_carlo(
    model: InverseModel,
    camera: Camera,
    shade: Callable[[ShadingPoints, torch.Generator], Tensor],
    num_repeats: int,
    points_per_ray: int,
    light: int,
    seed: int,
    purpose: str,
) -> Picture:
    """Average `shade` over points drawn along every ray; the noise comes from the spread over the draws."""
    device = _device(model)
    rays = camera_rays(model, camera, device)
    colour = torch.zeros(len(rays), 3, device=device)
    error = torch.zeros(len(rays), 3, device=device)
    opacity = torch.zeros(len(rays), 1, device=device)
    hits = (rays.far > rays.near).nonzero()[:, 0]
    for number, some in enumerate(hits.split(CHUNK_RAYS) if len(hits) else ()):
        generator = generator_for(seed, purpose, number, camera_key(camera), device)
        geometry = model.nerf.trace(rays.select(some), exponent=1.0, generator=None)
        opacity[some, 0] = geometry.opacity
        seen = geometry.opacity > OPACITY_FLOOR
        if not bool(seen.any()):
            continue
        pixels, weights = some[seen], geometry.weights[seen]
        num_samples = weights.shape[-1]
        row = num_samples * seen.nonzero()
        total = torch.zeros(len(pixels), 3, device=device)
        squares = torch.zeros_like(total)
        for _ in range(num_repeats):
            u = torch.rand(len(pixels), points_per_ray, generator=generator, device=device)
            # One draw per stratum of the cumulative weight: the same mean with less noise.
            strata = torch.arange(points_per_ray, device=device)
            index = (draw_points(weights, (u + strata) / points_per_ray).index + row).reshape(-1)
            owner = pixels.repeat_interleave(points_per_ray)
            points = ShadingPoints(
                positions=geometry.samples.positions.reshape(-1, 3)[index],
                normal=geometry.normal[index],
                omega_o=-rays.directions[owner],
                light_index=torch.full((len(index),), light, device=device),
            )
            values = shade(points, generator).reshape(len(pixels), points_per_ray, 3)
            total += values.sum(dim=1)
            squares += values.square().sum(dim=1)
        count = num_repeats * points_per_ray
        mean = total / count
        colour[pixels] = mean
        if count > 1:
            error[pixels] = ((squares / count - mean.square()).clamp_min(0.0) / (count - 1)).sqrt()
    shape = (camera.height, camera.width, -1)
    to_numpy = [values.reshape(shape).cpu().numpy() for values in (colour, error, opacity)]
    return Picture(*to_numpy)


def camera_key(camera: Camera) -> str:
    """Return a text that differs between cameras, for independent random streams."""
    return ",".join(f"{value:.6f}" for value in camera.camera_to_world[:3].reshape(-1))


def _device(model: InverseModel) -> torch.device:
    return next(model.parameters()).device
