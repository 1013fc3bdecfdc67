"""Occlusion and light transport of a given mesh: shadows are those of its own triangles.

The fast cache knows the object as it was trained, with the parts that were taken away or moved since.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float
from lambent_compute.threads import available_threads
from lambent_proto.v1 import bundle_pb2
from lambent_relight.baked.transport import transport_files
from lambent_relight.bundle.graphs import SecondaryHits
from lambent_relight.tracing.mesh_rays import MeshRays
from numpy import ndarray

from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.surface_occlusion import bake_occlusion
from lambent_asset.transport.transport import BakedSurface, TransportConfig, bake_transport
from lambent_asset.transport.transport_bounce import Reflectors
from lambent_asset.transport.transport_rays import RayConfig

OFFSET = 1e-4
"""Rays start this far above the mesh, as a share of its diagonal."""
Rows = Float[ndarray, "rays 3"]
Column = Float[ndarray, "rays 1"]


class TriangleRays:
    """Opacity, 0 or 1, and distance along rays against a mesh, as bakes ask for them."""

    def __init__(self, surface: AtlasSurface) -> None:
        """Prepare the mesh of `surface`."""
        self._rays = MeshRays(surface.vertices, surface.faces)
        self.offset = OFFSET * self._rays.size
        """Distance above the surface at which rays start, scene units."""

    def __call__(self, origin: Rows, direction: Rows) -> tuple[Column, Column]:
        """Return opacity and distance [scene units; 0 where nothing is met] of rays with unit directions."""
        found = self._rays(origin, direction)
        distance = np.where(found.blocked, found.distance, np.float32(0.0))
        return found.blocked[:, None].astype(np.float32), distance[:, None].astype(np.float32)


def occlusion_of(
    surface: AtlasSurface, rays: TriangleRays, *, num_points: int, num_rays: int
) -> Float[ndarray, " texels"]:
    """Return for each covered texel the share of cosine-weighted directions that are open, 0..1."""

    def secondary(origin: Rows, direction: Rows) -> SecondaryHits:
        opacity, distance = rays(origin, direction)
        return SecondaryHits(opacity=opacity, distance=distance)

    return bake_occlusion(
        surface, secondary, origin_offset=rays.offset, num_points=num_points, num_rays=num_rays
    )


def write_given_transport(
    surface: AtlasSurface,
    reflectors: Reflectors,
    rays: TriangleRays,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
    *,
    tier: str,
    store: Path,
    advance: Callable[[float], None],
) -> None:
    """Bake the transport of `surface` into `folder`/transport and describe it in `manifest`.

    `store` is a folder of its own for finished rays; `advance` is called with the finished share, and may
    raise to stop.
    """
    covered = BakedSurface(
        surface.size, surface.texel_index, surface.positions, surface.texel_normals.astype(np.float32)
    )
    transport, figures = bake_transport(
        covered,
        reflectors,
        rays,
        origin_offset=rays.offset,
        config=TransportConfig(tier=tier, rays=RayConfig(settled=0.0)),
        store=store,
        advance=advance,
        num_threads=available_threads(),
    )
    (folder / "transport").mkdir(exist_ok=True)
    for path, data in transport_files(transport, manifest).items():
        (folder / path).write_bytes(data)
    manifest.metrics.update(figures)
