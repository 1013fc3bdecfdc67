"""Deterministic pictures of a trained model's surface.

Pictures are numpy float32; radiance is linear Rec. 709.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from lambent_core.scene import Camera
from numpy import ndarray
from torch import Tensor

from flashcache.color import perceptual_roughness_from_alpha
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions
from flashcache.physical.model import InverseModel
from flashcache.volume.proposal_sampling import midpoints
from flashcache.volume.quadrature import composite

CHUNK_RAYS = 2048
OPACITY_FLOOR = 1e-3
"""Pixels below this opacity are empty and are not shaded."""


@dataclass(frozen=True, slots=True, eq=False)
class GBuffer:
    """The surface seen by a camera, as means over the render weights."""

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
    rays = clip_to_box(origins, directions, low, high, *domain.primary)
    return rays if model.nerf.occupancy is None else model.nerf.occupancy.narrowed(rays)


@torch.no_grad()
def render_gbuffer(model: InverseModel, camera: Camera, *, light: int = 0) -> GBuffer:
    """Return the surface as `camera` sees it, deterministic; the cache's picture is under light `light`."""
    device = next(model.parameters()).device
    rays = camera_rays(model, camera, device)
    values = torch.zeros(len(rays), 13, device=device)
    values[:, 4] = 1.0
    hits = (rays.far > rays.near).nonzero()[:, 0]

    def fill(some: Tensor) -> None:
        values[some] = _surface(model, rays.select(some), light)

    on_all_cores(fill, hits.split(CHUNK_RAYS) if len(hits) else (), device)
    picture = values.reshape(camera.height, camera.width, 13).cpu().numpy()
    opacity, distance, normal, albedo, width, metalness, colour = np.split(
        picture, [1, 2, 5, 8, 9, 10], axis=-1
    )
    return GBuffer(camera, opacity, distance, normal, albedo, width, metalness, colour)


def _surface(model: InverseModel, rays: Rays, light: int) -> Float[Tensor, "rays 13"]:
    """Return opacity, distance, normal, albedo, perceptual roughness, metalness and cache colour."""
    geometry = model.nerf.trace(rays, generator=None)
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
def cache_picture(
    model: InverseModel, rays: Rays, light: int
) -> tuple[Float[Tensor, "rays 3"], Float[Tensor, " rays"]]:
    """Return the NeRF cache's radiance along rays, premultiplied over black, and their opacity."""
    geometry = model.nerf.trace(rays, generator=None)
    index = torch.full((len(rays),), light, device=rays.origins.device)
    appearance = model.nerf.outgoing(geometry, rays.directions, index)
    return composite(geometry.weights, appearance.radiance), geometry.opacity
