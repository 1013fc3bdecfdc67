"""Our reflection model on true surfaces: rays that leave them meet the fused proxy, traced by Mitsuba.

Needs Mitsuba 3 (extra `dev`) with an LLVM library for its ray casting; no light is computed by it.
"""

from dataclasses import dataclass

import numpy as np
import torch
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
from make_sample_scene import load_renderer
from torch import Tensor

from benchmarks.oracle_geometry import Proxy

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
    corners: Int[Tensor, "hits 3"]
    """Vertices of the triangle."""
    shares: Float[Tensor, "hits 3"]
    """How much each of them counts; the sum is one."""

    def select(self, chosen: Bool[Tensor, " hits"]) -> "Hits":
        """Return some of the hits."""
        return Hits(
            self.index[chosen],
            self.distance[chosen],
            self.normal[chosen],
            select(self.materials, chosen),
            self.corners[chosen],
            self.shares[chosen],
        )

    def interpolate(self, values: Float[Tensor, "vertices k"]) -> Float[Tensor, "hits k"]:
        """Return what values of the vertices are at the hits."""
        return (values[self.corners] * self.shares[..., None]).sum(dim=1)


class ProxySurface:
    """The proxy, ready for rays."""

    def __init__(self, proxy: Proxy) -> None:
        load_renderer()
        import mitsuba as mi

        self._mi = mi
        self.vertices = proxy.vertices
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
        shares = torch.cat([1.0 - uv.sum(dim=-1, keepdim=True), uv], dim=-1)
        corners = self._faces[face]
        values = (self._maps[corners] * shares[..., None]).sum(dim=1)
        normal, albedo, alpha, metalness = values.split([3, 3, 1, 1], dim=-1)
        normal = torch.nn.functional.normalize(normal, dim=-1)
        return Hits(index, distance, normal, Materials(albedo, alpha, metalness), corners, shares)

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


def shade(
    surface: ProxySurface,
    points: ShadingPoints,
    materials: Materials,
    light: MapLight,
    *,
    bounces: int | None,
    num_directions: int,
    seed: int,
) -> Float[Tensor, "points 3"]:
    """Return the radiance of any number of points; `bounces` None leaves shadows out as well.

    Equal seeds draw equal directions, whatever the albedo.
    """
    if not len(points.positions):
        return points.positions
    generator = torch.Generator().manual_seed(seed)
    source = unoccluded if bounces is None else surface.source(light, bounces, generator)
    quarter = max(1, num_directions // 4)
    counts = DirectionCounts(cosine=quarter, sampler=quarter, specular=2 * quarter)
    parts = []
    for some in torch.arange(len(points.positions)).split(max(1, CHUNK_RAYS // counts.total)):
        chunk = ShadingPoints(*(column[some] for column in points))
        parts.append(lit(chunk, select(materials, some), light, source, counts, generator))
    return torch.cat(parts)


def select(materials: Materials, index: Tensor) -> Materials:
    """Return the materials of some of the points."""
    return Materials(materials.albedo[index], materials.alpha[index], materials.metalness[index])


def points_at(
    positions: Float[Tensor, "points 3"],
    normal: Float[Tensor, "points 3"],
    omega_o: Float[Tensor, "points 3"],
) -> ShadingPoints:
    """Return points to be shaded under the only light there is."""
    return ShadingPoints(positions, normal, omega_o, torch.zeros(len(positions), dtype=torch.long))
