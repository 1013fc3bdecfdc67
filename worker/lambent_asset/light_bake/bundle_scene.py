"""The scene of a light bake from a bundle alone: its fast cache in torch, its surface from its own networks.

A bundle has no NeRF cache. Its fast cache determines where rays stop, and its expected distance gives the
hit point; the second term of the estimate then only adds further bounces sooner.
"""

from dataclasses import dataclass

import numpy as np
import torch
from flashcache.caches.fast_cache import FastCache, FastCacheConfig
from flashcache.encoding.hash_grid import HashGridConfig
from flashcache.geometry.directions import facing
from flashcache.physical.brdf import Materials
from flashcache.physical.incident import RayLimits, SecondaryRays
from flashcache.physical.shading import ShadingPoints
from flashcache.training.bake_scene import RAYS_PER_POINT, rays_into_box
from flashcache.training.distillation_rays import SOLID
from flashcache.training.light_bake import Hits
from jaxtyping import Float
from lambent_core.errors import WorkerError
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.fused.grids import Grid
from lambent_relight.fused.reader import FusedCaches
from lambent_relight.fused.weights import NotFused, Weights, graph_constants
from torch import Tensor


def cache_of(bundle: Bundle, light: str) -> FastCache:
    """Return a bundle's fast cache under one of its training lights, as torch has it.

    Raises WorkerError `bake.network_unknown` where the bundle has another network.
    """
    try:
        return _cache_of(bundle, light)
    except NotFused as reason:
        raise WorkerError(
            "bake.network_unknown",
            f"the bundle's fast cache is not one that can be adapted ({reason}); export it again",
        ) from reason


def _cache_of(bundle: Bundle, light: str) -> FastCache:
    weights = Weights(bundle)
    names = ("contraction_radius", "near", "far", "num_frequencies")
    path = bundle.graph_path("fast_cache", light)
    constants = graph_constants(bundle, path, "fast_cache.v1", names)
    code, network = weights.layers("fast.code.layers"), weights.layers("fast.distance_network.layers")
    decoder = weights.layers("fast.decoder")
    if not code or not network or len(decoder) != 2:
        raise NotFused("the fast cache's layers are others")
    grids = {name: weights.grid(f"fast.{name}") for name in ("distance_grid", "feature_grid")}
    config = FastCacheConfig(
        **{name: _grid_config(grid) for name, grid in grids.items()},
        code_width=len(code[0].bias),
        code_layers=len(code),
        distance_width=len(network[0].bias),
        distance_layers=len(network),
        num_frequencies=int(constants["num_frequencies"]),
        num_samples=len(weights.tensor("fast.logit_head.bias")),
        decoder_widths=(len(decoder[0].bias), len(decoder[1].bias)),
    )
    ends = constants["near"], constants["far"]
    cache = FastCache(config, constants["contraction_radius"], 1, ends)
    heads = weights.layer(*(f"fast.{name}_head" for name in ("offset", "gate", "logit", "opacity")))
    layers = {
        **{f"code.layers.{index}": layer for index, layer in enumerate(code)},
        **{f"distance_network.layers.{index}": layer for index, layer in enumerate(network)},
        **{f"decoder.{index}": layer for index, layer in enumerate(decoder)},
        "distance_head": heads,
        "decoder_head": weights.layer(f"fast.decoder_head.{light}"),
    }
    state = {f"{name}.table": grid.table for name, grid in grids.items()}
    for name, layer in layers.items():
        state[f"{name}.weight"], state[f"{name}.bias"] = layer.weight, layer.bias
    tensors = {name: torch.from_numpy(np.array(values)) for name, values in state.items()}
    for name, grid in grids.items():
        tensors[f"{name}.levels"] = torch.from_numpy(grid.levels.copy())
    try:
        cache.load_state_dict(tensors)
    except RuntimeError as error:
        raise NotFused(f"its tensors do not fit: {str(error).splitlines()[-1].strip()}") from error
    return cache.eval()


def _grid_config(grid: Grid) -> HashGridConfig:
    resolution, rows = grid.levels[:, 0], grid.levels[:, 2]
    hashed = rows[rows < resolution**3]
    # Levels that are all dense fit any table that is large enough.
    table = int(hashed[0]) if len(hashed) else 1 << int(np.ceil(np.log2(rows.max())))
    return HashGridConfig(
        base_resolution=int(resolution[0]),
        finest_resolution=int(resolution[-1]),
        num_levels=len(resolution),
        num_features=grid.table.shape[1],
        log2_table_size=max(table.bit_length() - 1, 12),
        half_extent=grid.half_extent,
    )


@dataclass(frozen=True, eq=False)
class BundleScene:
    """Shape and materials of a bundle."""

    caches: FusedCaches
    limits: RayLimits
    viewpoints: Float[Tensor, "views 3"]
    """Positions of the bundle's cameras."""
    box: tuple[Float[Tensor, "3"], Float[Tensor, "3"]]
    albedo_ratio: Float[Tensor, "3"]

    def starts(self, count: int, generator: torch.Generator) -> ShadingPoints:
        """Return at most `count` points where rays from the cameras hit the surface in the bundle's box."""
        origins, directions = rays_into_box(self.viewpoints, self.box, RAYS_PER_POINT * count, generator)
        seen = self.caches.gbuffer(origins.numpy(), directions.numpy())
        kept = torch.from_numpy(np.flatnonzero(seen.opacity[:, 0] > SOLID)[:count])
        omega_o = -directions[kept]
        positions = origins[kept] + torch.from_numpy(seen.distance)[kept] * directions[kept]
        normal = facing(torch.from_numpy(seen.normal)[kept], omega_o)
        return ShadingPoints(positions, normal, omega_o, torch.zeros(len(kept), dtype=torch.long))

    def meet(self, rays: SecondaryRays, generator: torch.Generator) -> Hits:
        """Return the hits of secondary rays according to the fast cache."""
        seen = self.caches.secondary(rays.origins.numpy(), rays.directions.numpy())
        opacity, distance = (torch.from_numpy(values)[:, 0] for values in (seen.opacity, seen.distance))
        positions = rays.origins + distance[:, None] * rays.directions
        normal = torch.from_numpy(self.caches.material(positions.numpy()).normal)
        return Hits(opacity, distance, opacity, positions, normal)

    def materials(self, positions: Float[Tensor, "points 3"]) -> Materials:
        """Return the materials at points, with the albedo ratio applied."""
        stored = self.caches.material(positions.numpy())
        albedo = (torch.from_numpy(stored.albedo) * self.albedo_ratio).clamp(0.0, 1.0)
        alpha = torch.from_numpy(stored.perceptual_roughness).square()
        return Materials(albedo, alpha, torch.from_numpy(stored.metalness))


def bundle_scene(bundle: Bundle, albedo_ratio: Float[Tensor, "3"], *, num_threads: int) -> BundleScene:
    """Return the scene of a bundle; raises WorkerError `bake.network_unknown` for networks of other kinds."""
    try:
        caches = FusedCaches(bundle, num_threads=num_threads)
    except NotFused as reason:
        raise WorkerError(
            "bake.network_unknown", f"the bundle's networks are not known ({reason}); export it again"
        ) from reason
    manifest = bundle.manifest
    rays = manifest.secondary_rays
    eyes = np.stack([camera.camera_to_world[:3, 3] for camera in bundle.cameras()])
    low, high = (
        torch.tensor(list(corner), dtype=torch.float32)
        for corner in (manifest.bounds.minimum, manifest.bounds.maximum)
    )
    return BundleScene(
        caches=caches,
        limits=RayLimits(near=rays.near, far=rays.far, origin_offset=rays.origin_offset),
        viewpoints=torch.from_numpy(eyes.astype(np.float32)),
        box=(low, high),
        albedo_ratio=albedo_ratio,
    )
