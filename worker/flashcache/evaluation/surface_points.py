"""Points on a trained surface, and the photographs that see them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from lambent_core.scene import Camera, Scene
from torch import Tensor

from flashcache.evaluation.gbuffer import camera_rays
from flashcache.evaluation.radiance_derivatives import SeenPoints
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.directions import normalize
from flashcache.geometry.rays import Rays, clip_to_box
from flashcache.physical.incident import RadianceSource, SecondaryRays
from flashcache.physical.model import InverseModel
from flashcache.volume.quadrature import median_point

OPAQUE = 0.5
GRAZING = 0.05
"""Cosine at the viewer below which a photograph is ignored for a point."""
MAX_VIEWS = 10
"""Photographs per point that are evaluated; they represent all that see it."""
MAX_CHUNK_RAYS = 1 << 16
LINE_BATCHES = 6
"""Attempts to find the requested number of points; most lines through a box miss a small object."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """The points where rays first meet matter."""

    positions: Float[Tensor, "points 3"]
    normal: Float[Tensor, "points 3"]


class Projection(NamedTuple):
    """The positions of points in a camera's picture."""

    column: Float[Tensor, " points"]
    """Pixels from the left edge; the first pixel's centre is at 0.5."""
    row: Float[Tensor, " points"]
    """Pixels from the upper edge."""
    depth: Float[Tensor, " points"]
    """Along the optical axis, scene units; negative behind the camera, where column and row mean nothing."""


def project(camera: Camera, positions: Float[Tensor, "points 3"]) -> Projection:
    """Return the projection of world `positions` into a pinhole camera, inside its picture or not."""
    pose = positions.new_tensor(camera.camera_to_world)
    local = (positions - pose[:3, 3]) @ pose[:3, :3]
    depth = -local[:, 2]
    share = local[:, :2] / depth.clamp_min(1e-6)[:, None]
    column = camera.centre_x + camera.focal_x * share[:, 0]
    return Projection(column, camera.centre_y - camera.focal_y * share[:, 1], depth)


@torch.no_grad()
def first_hits(model: InverseModel, rays: Rays) -> SurfacePoints:
    """Return the points at which half of a ray's light is blocked, for the rays that are mostly blocked."""
    geometry = model.nerf.trace(rays, generator=None)
    weights = geometry.weights
    sample = median_point(weights).index[:, 0]
    flat = sample + weights.shape[1] * torch.arange(len(weights), device=weights.device)
    opaque = geometry.opacity > OPAQUE
    positions = geometry.samples.positions.reshape(-1, 3)[flat][opaque]
    return SurfacePoints(positions, geometry.normal[flat][opaque])


def photographed_points(
    model: InverseModel, cameras: Sequence[Camera], count: int, generator: torch.Generator
) -> SurfacePoints:
    """Return about `count` points that random pixels of the photographs show."""
    device = next(model.parameters()).device
    parts = []
    for camera in cameras:
        rays = camera_rays(model, camera, device)
        rays = rays.select(rays.far > rays.near)
        if not len(rays):
            continue
        # Most pixels miss the object: several times as many rays as points, then as many as were wanted.
        index = torch.randint(len(rays), (8 * count // len(cameras) + 1,), generator=generator, device=device)
        hits = first_hits(model, rays.select(index))
        parts.append(_some(hits, count // len(cameras) + 1, generator))
    return _some(join(parts), count, generator) if parts else _nothing(device)


def outer_points(model: InverseModel, count: int, generator: torch.Generator) -> SurfacePoints:
    """Return at most `count` points at which random lines through the scene's box first meet the surface.

    Also what no photograph shows; uniform over the surface as far as lines reach it.
    """
    parts: list[SurfacePoints] = []
    for _ in range(LINE_BATCHES):
        parts.append(first_hits(model, _random_lines(model, 4 * count, generator)))
        if sum(len(part.positions) for part in parts) >= count:
            break
    return _some(join(parts), count, generator)


def _random_lines(model: InverseModel, count: int, generator: torch.Generator) -> Rays:
    """Return those of `count` lines, uniform in direction and offset, that cross the scene's box."""
    device = next(model.parameters()).device
    low = torch.tensor(model.domain.bounds_min, device=device)
    high = torch.tensor(model.domain.bounds_max, device=device)
    directions = normalize(torch.randn(count, 3, generator=generator, device=device))
    across = torch.linalg.cross(directions, torch.randn(count, 3, generator=generator, device=device))
    radius = 0.5 * (high - low).norm()
    # Uniform on the disc that the ball around the box casts along the direction.
    offset = radius * torch.rand(count, 1, generator=generator, device=device).sqrt()
    origins = 0.5 * (low + high) + offset * normalize(across) - 2.0 * radius * directions
    rays = clip_to_box(origins, directions, low, high, 0.0, float(4.0 * radius))
    rays = rays if model.nerf.occupancy is None else model.nerf.occupancy.narrowed(rays)
    return rays.select(rays.far > rays.near)


def seen_points(
    model: InverseModel,
    points: SurfacePoints,
    scene: Scene,
    source: RadianceSource,
    generator: torch.Generator,
) -> tuple[SeenPoints, Float[Tensor, " points"]]:
    """Return the points with a few of the photographs that see each, and how many photographs do.

    A photograph is one camera under one light. `source` tells what hides them.
    """
    device = points.positions.device
    eyes = torch.from_numpy(np.stack([view.camera.position for view in scene.train])).float().to(device)
    shares = on_all_cores(lambda view: _visibility(model, points, view.camera, source), scene.train, device)
    visible = torch.stack(shares, dim=1)
    pairs = [
        (number, model.light_at(light, view.light_turn))
        for number, view in enumerate(scene.train)
        for light, name in enumerate(scene.lights)
        if name in view.images
    ]
    camera_of = torch.tensor([number for number, _ in pairs], device=device)
    light_of = torch.tensor([light for _, light in pairs], device=device)
    share = visible[:, camera_of]
    total = share.sum(dim=1)
    # Photographs that see the point, in random order, before those that do not.
    order = (share > 0.0) + torch.rand(share.shape, generator=generator, device=device)
    chosen = order.topk(min(MAX_VIEWS, len(pairs)), dim=1).indices
    kept = share.gather(1, chosen)
    scale = total / kept.sum(dim=1).clamp_min(1e-6)
    seen = SeenPoints(
        positions=points.positions,
        normal=points.normal,
        omega_o=normalize(eyes[camera_of[chosen]] - points.positions[:, None]),
        light_index=light_of[chosen],
        visibility=kept * scale[:, None],
    )
    return seen, total


@torch.no_grad()
def _visibility(
    model: InverseModel, points: SurfacePoints, camera: Camera, source: RadianceSource
) -> Float[Tensor, " points"]:
    """Return the share 0..1 of each point that a camera sees; 0 outside the picture and at grazing angles."""
    like = points.positions
    column, row, depth = project(camera, like)
    inside = (depth > 0.0) & (column >= 0.0) & (column < camera.width) & (row >= 0.0) & (row < camera.height)
    omega_o = normalize(like.new_tensor(camera.position) - like)
    facing = (points.normal * omega_o).sum(dim=-1)
    index = (inside & (facing > GRAZING)).nonzero()[:, 0]
    visible = torch.zeros_like(depth)
    for part in index.split(MAX_CHUNK_RAYS):
        limits = model.limits
        rays = SecondaryRays(
            origins=like[part] + limits.origin_offset * points.normal[part],
            directions=omega_o[part],
            near=limits.near,
            far=limits.far,
            light_index=torch.zeros_like(part),
        )
        visible[part] = (1.0 - source(rays).opacity).clamp(0.0, 1.0)
    return visible


def _some(points: SurfacePoints, count: int, generator: torch.Generator) -> SurfacePoints:
    """Return at most `count` of the points, chosen at random."""
    order = torch.randperm(len(points.positions), generator=generator, device=points.positions.device)
    return SurfacePoints(points.positions[order[:count]], points.normal[order[:count]])


def _nothing(device: torch.device) -> SurfacePoints:
    empty = torch.zeros(0, 3, device=device)
    return SurfacePoints(empty, empty)


def join(parts: Sequence[SurfacePoints]) -> SurfacePoints:
    """Return all points of `parts`, in their order."""
    return SurfacePoints(
        torch.cat([part.positions for part in parts]), torch.cat([part.normal for part in parts])
    )
