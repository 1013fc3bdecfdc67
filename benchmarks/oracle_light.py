"""Our reflection model on true surfaces: rays that leave them meet the fused proxy, traced by Mitsuba.

Needs Mitsuba 3 (extra `dev`) with an LLVM library for its ray casting; no light is computed by it.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from flashcache.data.scene import View
from flashcache.evaluation.relighting import BOUNCE_COUNTS, MapLight
from flashcache.physical.brdf import Materials
from flashcache.physical.estimator import DirectionCounts, EstimatorConfig, relight
from flashcache.physical.incident import (
    Incident,
    RadianceSource,
    RayLimits,
    SecondaryRays,
    unoccluded,
    visibility_only,
)
from flashcache.physical.shading import ShadingPoints
from jaxtyping import Bool, Float, Int
from oracle_geometry import Proxy, pixel_rays, single_surface
from torch import Tensor

sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))
from make_sample_scene import load_renderer

LIMITS = RayLimits(near=0.0, far=10.0, origin_offset=0.012)
"""Rays begin twice the 95th percentile of the proxy's error above the surface."""
CHUNK_RAYS = 1 << 19
DEEPER_SHARE = 0.25
"""Share of the points behind the first bounce that is followed further, and counted accordingly more."""
LEAVING_TRIES = 3
"""Walls from behind that a ray may pass; a ray that begins just inside the proxy leaves it that way."""


@dataclass(frozen=True, slots=True)
class Hits:
    """What rays meet first, for those that meet something."""

    index: Tensor
    """Positions of these rays among all."""
    distance: Float[Tensor, " hits"]
    normal: Float[Tensor, "hits 3"]
    materials: Materials

    def select(self, chosen: Bool[Tensor, " hits"]) -> "Hits":
        """Return some of the hits."""
        return Hits(
            self.index[chosen], self.distance[chosen], self.normal[chosen], _select(self.materials, chosen)
        )


class ProxySurface:
    """The proxy, ready for rays."""

    def __init__(self, proxy: Proxy) -> None:
        load_renderer()
        import mitsuba as mi

        self._mi = mi
        mesh = mi.Mesh("proxy", len(proxy.vertices), len(proxy.faces))
        buffers = mi.traverse(mesh)
        buffers["vertex_positions"] = proxy.vertices.astype(np.float32).ravel()
        buffers["faces"] = proxy.faces.astype(np.uint32).ravel()
        buffers.update()
        self._scene = mi.load_dict({"type": "scene", "proxy": mesh})
        corners = proxy.vertices[proxy.faces]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._outward = torch.tensor(outward, dtype=torch.float32)
        self._faces = torch.tensor(proxy.faces)
        maps = (proxy.normals, proxy.albedo, proxy.perceptual_roughness**2, proxy.metalness)
        self._maps = torch.tensor(np.concatenate(maps, axis=-1), dtype=torch.float32)

    def first_hits(self, origins: Float[Tensor, "rays 3"], directions: Float[Tensor, "rays 3"]) -> Hits:
        """Return the first surfaces met from outside."""
        index = torch.arange(len(origins))
        travelled = torch.zeros(len(origins))
        found: list[tuple[Tensor, Tensor, Tensor, Tensor]] = []
        for _ in range(LEAVING_TRIES):
            start = origins[index] + travelled[:, None] * directions[index]
            distance, face, uv = self._cast(start, directions[index])
            hit = distance < LIMITS.far
            index, distance, face, uv = index[hit], (travelled + distance)[hit], face[hit], uv[hit]
            outside = (self._outward[face] * directions[index]).sum(dim=-1) < 0.0
            found.append((index[outside], distance[outside], face[outside], uv[outside]))
            index, travelled = index[~outside], distance[~outside] + 1e-4
            if not len(index):
                break
        index, distance, face, uv = (torch.cat(column) for column in zip(*found, strict=True))
        shares = torch.cat([1.0 - uv.sum(dim=-1, keepdim=True), uv], dim=-1)[..., None]
        values = (self._maps[self._faces[face]] * shares).sum(dim=1)
        normal, albedo, alpha, metalness = values.split([3, 3, 1, 1], dim=-1)
        normal = torch.nn.functional.normalize(normal, dim=-1)
        return Hits(index, distance, normal, Materials(albedo, alpha, metalness))

    def _cast(self, origins: Tensor, directions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        mi = self._mi
        if not len(origins):  # Dr.Jit ends the process over arrays of no elements.
            return origins[:, 0], torch.zeros(0, dtype=torch.long), origins[:, :2]
        ray = mi.Ray3f(mi.Point3f(origins.T.numpy()), mi.Vector3f(directions.T.numpy()))
        met = self._scene.ray_intersect_preliminary(ray, coherent=False)
        distance, face, uv = (np.array(part) for part in (met.t, met.prim_index, met.prim_uv))
        return torch.from_numpy(distance), torch.from_numpy(face.astype(np.int64)), torch.from_numpy(uv.T)

    def source(
        self, light: MapLight, bounces: int, generator: torch.Generator, share: float = 1.0
    ) -> RadianceSource:
        """Return what arrives from the surface under `light` after at most `bounces` reflections on it.

        Only a random `share` of the points met is shaded, and counted accordingly more.
        """

        def near_field(rays: SecondaryRays) -> Incident:
            hits = self.first_hits(rays.origins, rays.directions)
            opacity = torch.zeros(len(rays)).index_fill(0, hits.index, 1.0)
            distance = torch.full((len(rays),), rays.far).index_copy(0, hits.index, hits.distance)
            radiance = torch.zeros_like(rays.origins)
            if bounces:
                chosen = hits.select(torch.rand(len(hits.index), generator=generator) < share)
                towards = -rays.directions[chosen.index]
                positions = rays.origins[chosen.index] - chosen.distance[:, None] * towards
                points = ShadingPoints(positions, chosen.normal, towards, rays.light_index[chosen.index])
                source = self.source(light, bounces - 1, generator, DEEPER_SHARE)
                reflected = lit(points, chosen.materials, light, source, BOUNCE_COUNTS, generator)
                radiance[chosen.index] = reflected / share
            return Incident(radiance, opacity, distance)

        return near_field if bounces else visibility_only(near_field)


def lit(
    points: ShadingPoints,
    materials: Materials,
    light: MapLight,
    source: RadianceSource,
    counts: DirectionCounts,
    generator: torch.Generator,
) -> Float[Tensor, "points 3"]:
    """Return the radiance that `points` send to their viewers."""
    return relight(
        points,
        materials,
        source=source,
        environment=light,
        light=light.sampler,
        counts=counts,
        limits=LIMITS,
        config=EstimatorConfig(stratified=True),
        generator=generator,
    ).rgb


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """Points to shade, and the covered pixels they belong to."""

    owner: Int[Tensor, " points"]
    """Position of the pixel among the covered ones."""
    points: ShadingPoints
    materials: Materials
    share: int
    """Points of one pixel, which share its directions."""

    def select(self, index: Tensor) -> "SurfaceSamples":
        """Return some of the points."""
        points = ShadingPoints(*(column[index] for column in self.points))
        return SurfaceSamples(self.owner[index], points, _select(self.materials, index), self.share)


class TrueSurface:
    """What the covered pixels of a test view see.

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
            self.samples = [means]
            return
        clean = torch.tensor(single_surface(view)).flatten()[self.pixels]
        fine = self._fine(grid, (~clean).nonzero()[:, 0])
        # A mixed pixel that the proxy misses keeps its means.
        clean[~clean] = ~torch.isin((~clean).nonzero()[:, 0], fine.owner)
        self.samples = [means.select(clean.nonzero()[:, 0]), fine]

    def _means(self, seen: dict[str, Tensor]) -> SurfaceSamples:
        camera = self.view.camera
        directions = torch.tensor(pixel_rays(camera), dtype=torch.float32).flatten(0, 1)[self.pixels]
        eye = torch.tensor(camera.position, dtype=torch.float32)
        normal = torch.nn.functional.normalize(seen["normal"][:, :3], dim=-1)
        points = _points(eye + seen["distance"] * directions, normal, -directions)
        alpha = seen["roughness"].clamp(0.01, 1.0).square()
        materials = Materials(seen["albedo"][:, :3], alpha, seen["metallic"])
        return SurfaceSamples(torch.arange(len(directions)), points, materials, 1)

    def _fine(self, grid: int, mixed: Tensor) -> SurfaceSamples:
        camera = self.view.camera
        finer = camera.resized(grid * camera.width, grid * camera.height)
        rays = torch.tensor(pixel_rays(finer), dtype=torch.float32)
        by_pixel = rays.reshape(camera.height, grid, camera.width, grid, 3).transpose(1, 2)
        directions = by_pixel.reshape(camera.height * camera.width, grid * grid, 3)[self.pixels[mixed]]
        directions = directions.reshape(-1, 3)
        owner = mixed.repeat_interleave(grid * grid)
        eye = torch.tensor(camera.position, dtype=torch.float32)
        hits = self.surface.first_hits(eye.expand_as(directions), directions)
        towards = -directions[hits.index]
        points = _points(eye - hits.distance[:, None] * towards, hits.normal, towards)
        return SurfaceSamples(owner[hits.index], points, hits.materials, grid * grid)

    def radiance(
        self,
        light: MapLight,
        bounces: int | None,
        num_directions: int,
        seed: int,
        albedo: float | None = None,
    ) -> Float[Tensor, "pixels 3"]:
        """Return the mean radiance of every covered pixel; `bounces` None leaves shadows out as well.

        `albedo` replaces the true one at the pixels, but not where light comes from. Equal seeds draw equal
        directions.
        """
        generator = torch.Generator().manual_seed(seed)
        source = unoccluded if bounces is None else self.surface.source(light, bounces, generator)
        total, count = torch.zeros(len(self.pixels), 3), torch.zeros(len(self.pixels), 1)
        for samples in self.samples:
            quarter = max(1, num_directions // samples.share // 4)
            counts = DirectionCounts(cosine=quarter, sampler=quarter, specular=2 * quarter)
            for index in torch.arange(len(samples.owner)).split(max(1, CHUNK_RAYS // (4 * quarter))):
                some = samples.select(index)
                materials = some.materials
                if albedo is not None:
                    white = torch.full_like(materials.albedo, albedo)
                    materials = Materials(white, materials.alpha, materials.metalness)
                radiance = lit(some.points, materials, light, source, counts, generator)
                total.index_add_(0, some.owner, radiance)
                count.index_add_(0, some.owner, torch.ones(len(index), 1))
        return total / count

    def albedo(self) -> Float[Tensor, "pixels 3"]:
        """Return the true albedo of the covered pixels, means at edges."""
        flat = torch.tensor(self.view.truth["albedo"][..., :3]).flatten(0, 1)
        return flat[self.pixels]

    def as_map(self, values: Float[Tensor, "pixels k"]) -> Float[np.ndarray, "height width k"]:
        """Return values of the covered pixels as a map, zero elsewhere."""
        camera = self.view.camera
        flat = torch.zeros(camera.height * camera.width, values.shape[-1]).index_copy(0, self.pixels, values)
        return flat.reshape(camera.height, camera.width, -1).numpy()


def _select(materials: Materials, index: Tensor) -> Materials:
    return Materials(materials.albedo[index], materials.alpha[index], materials.metalness[index])


def _points(positions: Tensor, normal: Tensor, omega_o: Tensor) -> ShadingPoints:
    return ShadingPoints(positions, normal, omega_o, torch.zeros(len(positions), dtype=torch.long))


def solve_albedo(
    photograph: Float[Tensor, "pixels 3"], black: Float[Tensor, "pixels 3"], white: Float[Tensor, "pixels 3"]
) -> Float[Tensor, "pixels 3"]:
    """Return the albedo that explains `photograph`, given the radiance of black and of white surfaces.

    Reflected radiance is an affine function of albedo: so are the diffuse lobe and Schlick's reflectance.
    Limited to 0..4, because little light leaves the quotient open.
    """
    return ((photograph - black) / (white - black).clamp_min(1e-4)).clamp(0.0, 4.0)
