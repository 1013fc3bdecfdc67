"""Surfaces behind the pixels of a view: the true ones of test views, and points of the proxy."""

from dataclasses import dataclass

import numpy as np
import torch
from flashcache.evaluation.relighting import MapLight
from flashcache.physical.brdf import Materials
from flashcache.physical.shading import ShadingPoints
from jaxtyping import Float, Int
from lambent_core.scene import Camera, View
from torch import Tensor

from benchmarks.oracle_geometry import pixel_rays, single_surface
from benchmarks.oracle_light import Hits, ProxySurface, points_at, select, shade


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """Points to shade, and the pixels they belong to."""

    owner: Int[Tensor, " points"]
    """Position of the pixel among those that were asked for."""
    points: ShadingPoints
    materials: Materials

    def select(self, index: Tensor) -> "SurfaceSamples":
        """Return some of the points."""
        points = ShadingPoints(*(column[index] for column in self.points))
        return SurfaceSamples(self.owner[index], points, select(self.materials, index))


def behind_pixels(
    surface: ProxySurface, camera: Camera, pixels: Int[Tensor, " pixels"], grid: int
) -> tuple[SurfaceSamples, Hits]:
    """Return where a grid of `grid` x `grid` rays through each pixel meets the proxy."""
    finer = camera.resized(grid * camera.width, grid * camera.height)
    rays = torch.tensor(pixel_rays(finer), dtype=torch.float32)
    by_pixel = rays.reshape(camera.height, grid, camera.width, grid, 3).transpose(1, 2)
    directions = by_pixel.reshape(camera.height * camera.width, grid * grid, 3)[pixels].reshape(-1, 3)
    owner = torch.arange(len(pixels)).repeat_interleave(grid * grid)
    eye = torch.tensor(camera.position, dtype=torch.float32)
    hits = surface.first_hits(eye.expand_as(directions), directions)
    towards = -directions[hits.index]
    points = points_at(eye - hits.distance[:, None] * towards, hits.normal, towards)
    return SurfaceSamples(owner[hits.index], points, hits.materials), hits


class TrueSurface:
    """The surfaces behind the covered pixels of a test view.

    A pixel that sees one surface is shaded at its centre with its own true maps. One that sees several is
    shaded at a grid of points on the proxy, because its maps are means over different surfaces.
    """

    def __init__(self, view: View, surface: ProxySurface, grid: int) -> None:
        """Look at `view`; `grid` counts points along the side of a mixed pixel, 1 shades its mean maps."""
        self.view, self.surface = view, surface
        truth = {name: torch.tensor(values).flatten(0, 1) for name, values in view.truth.items()}
        self.pixels = (truth["albedo"][:, 3] > 0.0).nonzero()[:, 0]
        means = self._means({name: values[self.pixels] for name, values in truth.items()})
        if grid == 1:
            self.samples = [(means, 1)]
            return
        clean = torch.tensor(single_surface(view)).flatten()[self.pixels]
        mixed = (~clean).nonzero()[:, 0]
        fine, _ = behind_pixels(surface, view.camera, self.pixels[mixed], grid)
        fine = SurfaceSamples(mixed[fine.owner], fine.points, fine.materials)
        # A mixed pixel that the proxy misses keeps its means.
        clean[mixed] = ~torch.isin(mixed, fine.owner)
        self.samples = [(means.select(clean.nonzero()[:, 0]), 1), (fine, grid * grid)]

    def _means(self, seen: dict[str, Tensor]) -> SurfaceSamples:
        camera = self.view.camera
        directions = torch.tensor(pixel_rays(camera), dtype=torch.float32).flatten(0, 1)[self.pixels]
        eye = torch.tensor(camera.position, dtype=torch.float32)
        normal = torch.nn.functional.normalize(seen["normal"][:, :3], dim=-1)
        points = points_at(eye + seen["distance"] * directions, normal, -directions)
        alpha = seen["roughness"].clamp(0.01, 1.0).square()
        materials = Materials(seen["albedo"][:, :3], alpha, seen["metallic"])
        return SurfaceSamples(torch.arange(len(directions)), points, materials)

    def radiance(
        self, light: MapLight, bounces: int | None, num_directions: int, seed: int
    ) -> Float[Tensor, "pixels 3"]:
        """Return the mean radiance of every covered pixel; `bounces` None leaves shadows out as well.

        The points of a pixel share its directions.
        """
        total, count = torch.zeros(len(self.pixels), 3), torch.zeros(len(self.pixels), 1)
        for samples, share in self.samples:
            radiance = shade(
                self.surface,
                samples.points,
                samples.materials,
                light,
                bounces=bounces,
                num_directions=num_directions // share,
                seed=seed,
            )
            total.index_add_(0, samples.owner, radiance)
            count.index_add_(0, samples.owner, torch.ones(len(radiance), 1))
        return total / count

    def as_map(self, values: Float[Tensor, "pixels k"]) -> Float[np.ndarray, "height width k"]:
        """Return values of the covered pixels as a map, zero elsewhere."""
        camera = self.view.camera
        flat = torch.zeros(camera.height * camera.width, values.shape[-1]).index_copy(0, self.pixels, values)
        return flat.reshape(camera.height, camera.width, -1).numpy()
