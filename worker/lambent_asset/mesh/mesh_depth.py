"""Distance between a mesh and the volume it was made from, as photographs see both."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from flashcache.evaluation.gbuffer import camera_rays
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.rays import Rays
from flashcache.physical.model import InverseModel
from jaxtyping import Float
from lambent_core.scene import Camera, View
from lambent_relight import cameras as relight_cameras
from lambent_relight.baked.raster import rasterise
from numpy.typing import NDArray
from torch import Tensor

NUM_VIEWS = 8
NUM_PIXELS = 4000
"""Pixels of a view that take part, drawn among those that the mesh covers."""
SOLID = 0.9
"""Least opacity of the volume in a pixel that takes part."""
CHUNK_RAYS = 2048


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthAgreement:
    """Distances along the ray between mesh and volume, in pixels of the photographs at that distance."""

    median: float
    p95: float
    worst_view: str
    worst_p95: float
    """The 95th percentile in the view where it is largest."""


def relight_camera(name: str, camera: Camera) -> relight_cameras.Camera:
    """Return a camera as clients read it."""
    values = {field.name: getattr(camera, field.name) for field in fields(camera)}
    return relight_cameras.Camera(name=name, **values)


def depth_agreement(
    model: InverseModel,
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    views: tuple[View, ...],
    *,
    seed: int = 0,
) -> DepthAgreement | None:
    """Return how well the mesh's distances agree with the volume's; None where no view shows both.

    `views` count with their own pixels: those that the model was trained with.
    """
    random = np.random.default_rng(seed)
    by_view = {view.name: _of_view(model, vertices, faces, view, random) for view in views}
    by_view = {name: apart for name, apart in by_view.items() if len(apart)}
    if not by_view:
        return None
    together = np.concatenate(list(by_view.values()))
    worst = max(by_view, key=lambda name: float(np.quantile(by_view[name], 0.95)))
    return DepthAgreement(
        median=float(np.median(together)),
        p95=float(np.quantile(together, 0.95)),
        worst_view=worst,
        worst_p95=float(np.quantile(by_view[worst], 0.95)),
    )


def _of_view(
    model: InverseModel,
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    view: View,
    random: np.random.Generator,
) -> NDArray[np.float64]:
    """Return |mesh - volume| of some pixels, in pixels."""
    device = next(model.parameters()).device
    depth = rasterise(vertices, faces, relight_camera(view.name, view.camera)).depth.reshape(-1)
    covered = np.flatnonzero(np.isfinite(depth))
    if len(covered) > NUM_PIXELS:
        covered = np.sort(random.choice(covered, NUM_PIXELS, replace=False))
    rays = camera_rays(model, view.camera, device)
    index = torch.from_numpy(covered).to(device)
    index = index[(rays.far > rays.near)[index]]
    if not len(index):
        return np.zeros(0)
    parts = on_all_cores(
        lambda some: median_distance(model, rays.select(some)), index.split(CHUNK_RAYS), device
    )
    volume = torch.cat(parts).cpu().numpy().astype(np.float64)
    mesh = depth[index.cpu().numpy()].astype(np.float64)
    apart = np.abs(mesh - volume[:, 1]) / volume[:, 1] * view.camera.focal_x
    return apart[volume[:, 0] > SOLID]


@torch.no_grad()
def median_distance(model: InverseModel, rays: Rays) -> Float[Tensor, "rays 2"]:
    """Return opacity, and the distance before which half of it lies, scene units, as the model is traced.

    The half, and not the mean: where a ray passes an edge and reaches what is behind, the mean lies
    between the two, where nothing is. Weights count as evenly spread over their intervals.
    """
    geometry = model.nerf.trace(rays, generator=None)
    weights, edges = geometry.weights, geometry.samples.distances
    total = weights.cumsum(dim=-1)
    half = 0.5 * total[:, -1:]
    index = (total < half).sum(dim=-1, keepdim=True).clamp_max(weights.shape[-1] - 1)
    here = weights.gather(-1, index)
    share = (half - (total.gather(-1, index) - here)) / here.clamp_min(1e-12)
    start, end = edges.gather(-1, index), edges.gather(-1, index + 1)
    distance = start + share.clamp(0.0, 1.0) * (end - start)
    return torch.cat([total[:, -1:], distance], dim=-1)
