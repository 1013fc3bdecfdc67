"""The albedo that explains all training photographs at once, everything else about the scene being true.

Reflected radiance is an affine function of albedo: so are the diffuse lobe and Schlick's reflectance. With
the radiance of a black and of a white surface, every photograph states a linear equation at the points it
shows; least squares over all of them gives the albedo at the vertices of the proxy.
"""

import numpy as np
import torch
from flashcache.evaluation.relighting import MapLight
from flashcache.physical.brdf import Materials
from jaxtyping import Float
from lambent_core.scene import View
from scipy.spatial import cKDTree
from torch import Tensor

from benchmarks.oracle_light import ProxySurface, shade
from benchmarks.oracle_views import behind_pixels

SATURATED = 0.999
"""Linear value from which a photograph says only that there was at least so much light."""
CORNER_GRID = 3
"""Rays along the side of a pixel that tell whether it sees one surface."""
FLATNESS = 0.5
"""Largest distance of those from the middle one's tangent plane, in pixels."""


class AlbedoFit:
    """Equations of the photographs so far."""

    def __init__(self, surface: ProxySurface) -> None:
        self.surface = surface
        self._products = torch.zeros(len(surface.vertices), 3)
        self.evidence = torch.zeros(len(surface.vertices), 3)
        """How firmly each vertex and channel is determined: the sum of squared slopes."""

    def observe(
        self,
        view: View,
        light_name: str,
        light: MapLight,
        bounces: int | None,
        num_directions: int,
        seed: int,
    ) -> None:
        """Add the pixels of a photograph that show one surface and are not saturated, channel by channel."""
        picture = torch.tensor(view.images[light_name]).flatten(0, 1)
        opaque = (picture[:, 3] > 0.99).nonzero()[:, 0]
        opaque = opaque[self._see_one_surface(view, opaque)]
        samples, hits = behind_pixels(self.surface, view.camera, opaque, 1)
        photograph = picture[opaque[samples.owner], :3]
        true = samples.materials
        black, white = (
            shade(
                self.surface,
                samples.points,
                Materials(torch.full_like(photograph, level), true.alpha, true.metalness),
                light,
                bounces=bounces,
                num_directions=num_directions,
                seed=seed,
            )
            for level in (0.0, 1.0)
        )
        slope = (white - black) * (photograph < SATURATED)
        for corner in range(3):
            share = hits.shares[:, corner, None]
            self._products.index_add_(0, hits.corners[:, corner], share * slope * (photograph - black))
            self.evidence.index_add_(0, hits.corners[:, corner], share * slope.square())

    def _see_one_surface(self, view: View, pixels: Tensor) -> Tensor:
        samples, _ = behind_pixels(self.surface, view.camera, pixels, CORNER_GRID)
        count = torch.zeros(len(pixels)).index_add_(0, samples.owner, torch.ones(len(samples.owner)))
        normal = torch.zeros(len(pixels), 3).index_add_(0, samples.owner, samples.points.normal)
        middle = torch.zeros(len(pixels), 3).index_add_(0, samples.owner, samples.points.positions)
        middle = middle / count.clamp_min(1.0)[:, None]
        normal = torch.nn.functional.normalize(normal, dim=-1)
        offset = samples.points.positions - middle[samples.owner]
        off = (offset * normal[samples.owner]).sum(dim=-1).abs()
        eye = torch.tensor(view.camera.position, dtype=torch.float32)
        pixel = (samples.points.positions - eye).norm(dim=-1) / view.camera.focal_x
        far = (off > FLATNESS * pixel).float()
        return (count == CORNER_GRID**2) & (torch.zeros(len(pixels)).index_add_(0, samples.owner, far) == 0.0)

    def solve(self) -> Float[Tensor, "vertices 3"]:
        """Return the albedo in [0, 1] at the vertices; unseen vertices take that of the nearest seen one."""
        known = (self.evidence > 1e-6).all(dim=-1)
        albedo = (self._products / self.evidence.clamp_min(1e-12)).clamp(0.0, 1.0)
        vertices = self.surface.vertices
        _, nearest = cKDTree(vertices[known.numpy()]).query(vertices[~known.numpy()])
        albedo[~known] = albedo[known][torch.from_numpy(np.asarray(nearest))]
        return albedo


def albedo_map(
    surface: ProxySurface, albedo: Float[Tensor, "vertices 3"], view: View, grid: int
) -> Float[np.ndarray, "height width 4"]:
    """Return a view of albedo at the vertices, means over pixels, with the view's true opacity."""
    camera, opacity = view.camera, view.truth["albedo"][..., 3:]
    pixels = torch.tensor(opacity.reshape(-1) > 0.0).nonzero()[:, 0]
    samples, hits = behind_pixels(surface, camera, pixels, grid)
    total = torch.zeros(len(pixels), 3).index_add_(0, samples.owner, hits.interpolate(albedo))
    count = torch.zeros(len(pixels), 1).index_add_(0, samples.owner, torch.ones(len(samples.owner), 1))
    flat = torch.zeros(camera.height * camera.width, 3)
    flat[pixels] = total / count.clamp_min(1.0)
    return np.concatenate([flat.reshape(camera.height, camera.width, 3).numpy(), opacity], axis=-1)
