"""Visibility around every texel, from rays in stratified directions against the mesh.

Every texel uses the directions of one of 16 sets that are above its horizon. All sets are the same 256 evenly
distributed directions, each jittered within its own cell of the sphere, so that neighbouring texels sample
between each other's directions. Half of the directions are traced first; a texel with nearly uniform results
is settled, and takes each other direction from its nearest neighbour. Only the rest trace the second half.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from lambent_compute.threads import in_order
from lambent_relight.baked.traced_surface import MESH_OFFSET
from lambent_relight.baked.transport import NUM_SHADOW_DIRECTIONS, coarse_blocks, shadow_directions
from lambent_relight.tracing.mesh_rays import MeshRays
from numpy import ndarray

NUM_SETS = 16
CELL = 4.0 * np.pi / NUM_SHADOW_DIRECTIONS
"""Solid angle of one direction, sr."""
NOT_STORED = -1.0


class SecondaryRays(Protocol):
    """What is in the way: rays [ray, 3] to opacity and distance [ray, 1] each."""

    def __call__(
        self, origin: Float[ndarray, "rays 3"], direction: Float[ndarray, "rays 3"]
    ) -> tuple[Float[ndarray, "rays 1"], Float[ndarray, "rays 1"]]:
        """Return the hits of rays from offset surface points."""


class TriangleRays:
    """Opacity, 0 or 1, and distance along rays against a mesh, as bakes ask for them."""

    def __init__(self, vertices: Float[ndarray, "vertices 3"], faces: Int[ndarray, "faces 3"]) -> None:
        self._rays = MeshRays(vertices, faces)
        self.offset = MESH_OFFSET * self._rays.size
        """Distance above the surface at which rays start, scene units."""

    def __call__(
        self, origin: Float[ndarray, "rays 3"], direction: Float[ndarray, "rays 3"]
    ) -> tuple[Float[ndarray, "rays 1"], Float[ndarray, "rays 1"]]:
        """Return opacity and distance [scene units; 0 where nothing is met] of rays with unit directions."""
        hits = self._rays(origin, direction)
        distance = np.where(hits.blocked, hits.distance, np.float32(0.0))
        return hits.blocked[:, None].astype(np.float32), distance[:, None].astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class BakedSurface:
    """The covered texels of an atlas, in the order of `texel_index`."""

    size: int
    texel_index: Int[ndarray, " texels"]
    positions: Float[ndarray, "texels 3"]
    normals: Float[ndarray, "texels 3"]

    @property
    def blocks(self) -> tuple[Int[ndarray, " coarse"], Int[ndarray, " texels"]]:
        """Return the texels that stand for blocks, which have indirect light, and the block of each texel."""
        return coarse_blocks(self.size, self.texel_index)

    @property
    def sets(self) -> Int[ndarray, " texels"]:
        """Return each texel's set of directions: a 4 x 4 pattern, with distant sets next to each other."""
        row, column = np.divmod(self.texel_index.astype(np.int64), self.size)
        pattern = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])
        return pattern[row % 4, column % 4]


@dataclass(frozen=True, kw_only=True, slots=True)
class RayConfig:
    """Ray budget of a texel."""

    texels_per_chunk: int = 2048
    """Texels that are traced and stored together."""
    settled: float = 0.2
    """Cosine-weighted standard deviation of opacity over the first half that settles a texel."""
    followed: float = 0.05
    """Rays with more opacity than this light the texel by what they hit."""
    jitter: float = 0.9
    """Largest jitter of a direction, as a share of the radius of its cell."""


MESH_RAYS = RayConfig(settled=0.0)
"""Rays against a mesh cost so little that none is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Occlusion:
    """Opacity in every direction of a texel's set; 0 below the horizon."""

    opacity: UInt8[ndarray, "texels directions"]
    """Times 255."""
    distance: Float[ndarray, "coarse directions"]
    """For the texels that stand for a coarse one, in the order of those, scene units; NOT_STORED where
    nothing was traced or hit."""
    set_of_texel: Int[ndarray, " texels"]
    num_rays: int

    def in_set(self, index: int) -> Int[ndarray, " some"]:
        """Return the texels that use the directions of one set."""
        return np.flatnonzero(self.set_of_texel == index)


def direction_sets(config: RayConfig) -> Float[ndarray, "sets directions 3"]:
    """Return the directions of every set; deterministic."""
    centre = shadow_directions()
    rng = np.random.default_rng(20_240_611)
    helper = np.where(np.abs(centre[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    tangent = np.cross(centre, helper)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bitangent = np.cross(centre, tangent)
    # The radius of a disc as large as a cell; one direction's moves are stratified over the sets.
    radius = config.jitter * np.sqrt(CELL / np.pi)
    order = np.argsort(rng.random((NUM_SHADOW_DIRECTIONS, NUM_SETS)), axis=1).T
    distance = radius * np.sqrt((order + rng.random(order.shape)) / NUM_SETS)[..., None]
    angle = (2.0 * np.pi * (order * 0.618034 + rng.random(order.shape) / NUM_SETS))[..., None]
    moved = centre + distance * (np.cos(angle) * tangent + np.sin(angle) * bitangent)
    return (moved / np.linalg.norm(moved, axis=-1, keepdims=True)).astype(np.float32)


def cast(
    surface: BakedSurface,
    secondary: SecondaryRays,
    *,
    origin_offset: float,
    config: RayConfig,
    store: Path,
    advance: Callable[[float], None] = lambda share: None,
    num_threads: int = 1,
) -> Occlusion:
    """Return the hits of all texels' rays, and the distances of those of texels that stand for blocks.

    Finished chunks are in `store` and are not traced again; the folder must belong to this surface and
    model. `advance` is called with the finished share and may raise to stop. Chunks are traced in
    `num_threads` threads, which call `secondary` at once.
    """
    sets, set_of_texel = direction_sets(config), surface.sets
    coarse, count = surface.blocks[0], len(surface.positions)
    keeps_distance = np.zeros(count, bool)
    keeps_distance[coarse] = True
    store.mkdir(parents=True, exist_ok=True)
    opacities, distances, num_rays = [], [], 0
    starts = range(0, count, config.texels_per_chunk)

    def stored(start: int) -> Path:
        part = slice(start, start + config.texels_per_chunk)
        path = store / f"{start:08d}.npz"
        if not path.exists():
            origins = surface.positions[part] + np.float32(origin_offset) * surface.normals[part]
            opacity, distance, traced = _cast_chunk(
                origins, surface.normals[part], sets[set_of_texel[part]], secondary, config
            )
            partial = path.with_name(f".partial-{path.name}")
            np.savez(partial, opacity=opacity, distance=distance[keeps_distance[part]], num_rays=traced)
            partial.rename(path)
        return path

    with closing(in_order(stored, starts, num_threads)) as paths:
        for start, path in zip(starts, paths, strict=True):
            with np.load(path) as chunk:
                opacities.append(chunk["opacity"])
                distances.append(chunk["distance"])
                num_rays += int(chunk["num_rays"])
            advance(min(1.0, (start + config.texels_per_chunk) / count))
    # They were kept in the order of the texels, in which a block that begins in its lower row comes late.
    distance = np.concatenate(distances)[np.argsort(np.argsort(coarse))]
    return Occlusion(np.concatenate(opacities), distance, set_of_texel, num_rays)


def _cast_chunk(
    origins: Float[ndarray, "texels 3"],
    normals: Float[ndarray, "texels 3"],
    directions: Float[ndarray, "texels directions 3"],
    secondary: SecondaryRays,
    config: RayConfig,
) -> tuple[UInt8[ndarray, "texels directions"], Float[ndarray, "texels directions"], int]:
    cosine = np.einsum("tdi,ti->td", directions, normals)
    above = cosine > 0.0
    opacity = np.zeros(above.shape, np.uint8)
    distance = np.full(above.shape, NOT_STORED, np.float16)
    num_rays = 0

    def ask(wanted: Bool[ndarray, "texels directions"]) -> None:
        nonlocal num_rays
        texel, direction = np.nonzero(wanted)
        seen, far = secondary(origins[texel], directions[texel, direction])
        opacity[texel, direction] = np.round(255.0 * np.clip(seen[:, 0], 0.0, 1.0))
        distance[texel, direction] = np.where(seen[:, 0] > config.followed, far[:, 0], NOT_STORED)
        num_rays += len(texel)

    first = above.copy()
    first[:, 1::2] = False
    ask(first)
    settled = _spread(opacity[:, ::2], cosine[:, ::2]) < config.settled
    ask(above & ~first & ~settled[:, None])
    rows = np.flatnonzero(settled)
    opacity[rows] = np.where(above[rows], opacity[rows][:, _nearest_of_first_half()], 0)
    return opacity, distance, num_rays


def _spread(
    opacity: UInt8[ndarray, "texels directions"], cosine: Float[ndarray, "texels directions"]
) -> Float[ndarray, " texels"]:
    """Return the standard deviation of opacity over directions above the horizon, weighted by the cosine."""
    weight = np.maximum(cosine, 0.0)
    total = np.maximum(weight.sum(axis=1), 1e-6)
    share = opacity / 255.0
    mean = (weight * share).sum(axis=1) / total
    return np.sqrt((weight * (share - mean[:, None]) ** 2).sum(axis=1) / total)


def _nearest_of_first_half() -> Int[ndarray, " directions"]:
    """Return for each direction the nearest one with an even number; for those, themselves."""
    centre = shadow_directions()
    return 2 * np.argmax(centre @ centre[::2].T, axis=1)
