"""Uncertainty of the materials: measured at points of the surface, stored as a grid.

docs/discussion/uncertainty.md says what the values mean.
"""

from dataclasses import dataclass

import numpy as np
import torch
from flashcache.evaluation.ambiguity import Elimination, Priors, eliminate, material_uncertainty
from flashcache.evaluation.gbuffer import cache_picture, camera_rays
from flashcache.evaluation.monte_carlo import RenderRule
from flashcache.evaluation.radiance_derivatives import Noise, linear_model
from flashcache.evaluation.surface_points import (
    SurfacePoints,
    join,
    outer_points,
    photographed_points,
    seen_points,
)
from flashcache.evaluation.threads import on_all_cores
from flashcache.physical.model import InverseModel
from flashcache.polish.confidence import Confidence
from flashcache.randomness import generator_for
from jaxtyping import Float, Float32
from lambent_core.scene import Camera, Scene, evenly_spaced
from lambent_relight.bundle.uncertainty import CHANNELS, UncertaintyGrid
from numpy import ndarray
from scipy.spatial import cKDTree

PRIORS = Priors()
NUM_POINTS = 1000
FEWEST_POINTS = 16
"""Below this there is no surface to speak of."""
NUM_CAMERAS = 12
"""Training cameras whose pixels choose points."""
NOISE_VIEWS = 3
NOISE_PIXELS = 1000
SMALLEST_NOISE = 1.0 / 255.0
GRID_CELLS = 40
"""Cells along the longest side of the box around the points."""
NEIGHBOURS = 4
NEAR_POINT = 1e-4
"""Distance below which places are the same, scene units."""
CHUNK_POINTS = 32
MANY_VIEWS = 1e4
"""Bound on the number of photographs, which float16 holds."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoints:
    """Surface points and what is known about each, in the order of `bundle.uncertainty.CHANNELS`."""

    positions: Float32[ndarray, "points 3"]
    values: Float32[ndarray, "points channels"]


def measure_uncertainty(
    model: InverseModel,
    scene: Scene,
    *,
    seed: int,
    rule: RenderRule,
    num_points: int = NUM_POINTS,
    priors: Priors = PRIORS,
    confidence: Confidence | None = None,
) -> UncertaintyGrid | None:
    """Return the uncertainty of the materials of `model` given the training photographs of `scene`.

    Half of the points lie where photographs look, half anywhere on the outer surface. None where there are no
    training photographs, or the model has hardly any surface. With the `confidence` of a polish, its elements
    take the place of the points near them.
    """
    if not scene.train:
        return None
    device = next(model.parameters()).device
    generator = generator_for(seed, "uncertainty", 0, "points", device)
    cameras = [view.camera for view in evenly_spaced(scene.train, NUM_CAMERAS)]
    shown = photographed_points(model, cameras, num_points // 2, generator)
    points = join([shown, outer_points(model, num_points - len(shown.positions), generator)])
    if len(points.positions) < FEWEST_POINTS:
        return None
    noise = Noise(absolute=residual(model, scene, seed))
    measured = measure_points(model, points, scene, noise=noise, rule=rule, priors=priors, seed=seed)
    return grid_of(measured if confidence is None else with_confidence(measured, confidence))


@torch.no_grad()
def measure_points(
    model: InverseModel,
    points: SurfacePoints,
    scene: Scene,
    *,
    noise: Noise,
    rule: RenderRule,
    priors: Priors,
    seed: int,
) -> MeasuredPoints:
    """Return the uncertainty at given surface points."""
    device = points.positions.device
    generator = generator_for(seed, "uncertainty", 1, "photographs", device)
    source = model.fast_source() if rule.shadow_cache == "fast" else model.nerf_source(None)
    seen, num_views = seen_points(model, points, scene, source, generator)

    def eliminated(start: int) -> Elimination:
        some = seen.select(slice(start, start + CHUNK_POINTS))
        return eliminate(linear_model(model, some, source, noise), priors)

    parts = on_all_cores(eliminated, range(0, len(points.positions), CHUNK_POINTS), device)
    uncertainty = material_uncertainty(Elimination.join(parts), priors)
    columns = [
        uncertainty.albedo.square().mean(dim=1).sqrt(),
        uncertainty.albedo_from_light.square().mean(dim=1).sqrt(),
        uncertainty.metalness,
        uncertainty.perceptual_roughness,
        num_views.clamp_max(MANY_VIEWS),
    ]
    values = torch.stack(columns, dim=1).float().cpu().numpy()
    return MeasuredPoints(points.positions.float().cpu().numpy(), values)


def with_confidence(points: MeasuredPoints, confidence: Confidence) -> MeasuredPoints:
    """Return the elements of a polish, and those of `points` that are near none.

    The photographs' part is the polish's. What the unknown light adds to it, and the number of photographs,
    are those of the nearest points.
    """
    near = _interpolated(points, confidence.positions.numpy(), NEAR_POINT)
    around = dict(zip(CHANNELS, near.T, strict=True))
    albedo = np.square(confidence.log_albedo.numpy()).mean(axis=1)
    of_elements = {
        "albedo": np.sqrt(albedo + np.square(around["albedo_from_light"])),
        "albedo_from_light": around["albedo_from_light"],
        "metalness": confidence.metalness.numpy(),
        "perceptual_roughness": confidence.perceptual_roughness.numpy(),
        "views": around["views"],
    }
    alone = confidence.at(torch.from_numpy(points.positions)).metalness.isnan().numpy()
    values = np.stack([of_elements[name] for name in CHANNELS], axis=1).astype(np.float32)
    return MeasuredPoints(
        np.concatenate([confidence.positions.numpy(), points.positions[alone]]),
        np.concatenate([values, points.values[alone]]),
    )


def residual(model: InverseModel, scene: Scene, seed: int) -> float:
    """Return the root mean square error of the NeRF cache on photographed pixels of the object.

    Linear radiance, clipped at white like photographs, at least one step of 8 bits: what a photograph and a
    model of this quality may differ by. 1 where no pixel is opaque in both.
    """
    device = next(model.parameters()).device
    generator = np.random.default_rng(seed)
    light = scene.lights[0]
    errors = []
    lit = tuple(view for view in scene.train if light in view.images)
    for view in evenly_spaced(lit, NOISE_VIEWS):
        image = view.images[light].reshape(-1, 4)
        opaque = np.flatnonzero(image[:, 3] > 0.99)
        if not len(opaque):
            continue
        index = generator.permutation(opaque)[:NOISE_PIXELS]
        rays = camera_rays(model, view.camera, device).select(torch.from_numpy(index).to(device))
        radiance, opacity = cache_picture(model, rays, model.light_at(0, view.light_turn))
        rendered = radiance.cpu().numpy()[opacity.cpu().numpy() > 0.5]
        wanted = image[index][opacity.cpu().numpy() > 0.5, :3]
        errors.append(np.square(np.clip(rendered, 0.0, 1.0) - np.clip(wanted, 0.0, 1.0)).reshape(-1))
    everything = np.concatenate([np.zeros(0), *errors])
    return max(SMALLEST_NOISE, float(np.sqrt(everything.mean()))) if everything.size else 1.0


def grid_of(points: MeasuredPoints, cells: int = GRID_CELLS) -> UncertaintyGrid:
    """Return values at points as a grid: means of the nearest points by inverse squared distance."""
    low, high = points.positions.min(axis=0).astype(np.float64), points.positions.max(axis=0)
    margin = max(0.02 * float((high - low).max()), 1e-3)
    low, high = low - margin, high + margin
    counts = np.maximum(1, np.round(cells * (high - low) / (high - low).max())).astype(int)
    axes = [low[k] + (np.arange(counts[k]) + 0.5) * (high[k] - low[k]) / counts[k] for k in range(3)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    values = _interpolated(points, centres, 0.1 * margin)
    return UncertaintyGrid(low, high, values.reshape(*counts, -1).astype(np.float32))


def _interpolated(
    points: MeasuredPoints, places: Float[ndarray, "places 3"], softness: float
) -> Float[ndarray, "places channels"]:
    """Return means of the nearest points by inverse squared distance; `softness` is a distance too."""
    near = min(NEIGHBOURS, len(points.positions))
    distance, index = cKDTree(points.positions).query(places, k=[*range(1, near + 1)])
    weight = 1.0 / (distance**2 + softness**2)
    weight /= weight.sum(axis=1, keepdims=True)
    return (weight[..., None] * points.values[index]).sum(axis=1)


def uncertainty_map(
    model: InverseModel, grid: UncertaintyGrid, camera: Camera, distance: Float[ndarray, "height width 1"]
) -> Float32[ndarray, "height width channels"]:
    """Return the grid's values at `distance` along the rays of a camera; zero where the distance is."""
    device = next(model.parameters()).device
    directions = camera_rays(model, camera, device).directions.cpu().numpy()
    positions = camera.position + distance * directions.reshape(camera.height, camera.width, 3)
    return np.where(distance > 0.0, grid.at(positions), 0.0).astype(np.float32)
