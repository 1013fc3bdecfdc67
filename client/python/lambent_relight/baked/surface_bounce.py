"""Indirect light at any point of a baked surface, between the places where it was baked.

Indirect irradiance is known once for every block of 2 x 2 texels, at the block's first texel. Between them it
is bilinear over the atlas. A block that is elsewhere in space, because another chart begins there, or that
faces elsewhere, has no part in it, and a point without any block of its own has no baked light.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from lambent_core.directions import dot
from numpy.typing import NDArray

from lambent_relight.baked.scene import BakedScene, texel_positions
from lambent_relight.baked.transport import coarse_blocks

NEAR = 2.5
"""A block takes part up to this distance from a point, in sides of a block."""
ALIKE = 0.5
"""And up to this cosine between the normals."""


@dataclass(frozen=True)
class BlockWeights:
    """The blocks around points; a point's weights sum to one, or to zero where it has none."""

    block: NDArray[np.int32]
    """[point, 4]; 0 where the weight is 0."""
    weight: NDArray[np.float32]
    """[point, 4]."""

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether a point has any block, [point, 1]."""
        return np.asarray(self.weight.max(axis=1, keepdims=True) > 0.0)

    def mean(self, values: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return the weighted means of `values` [block, n], [point, n]; zero where there is no block."""
        return np.einsum("pk,pkn->pn", self.weight, values[self.block]).astype(np.float32)


class SurfaceBlocks:
    """The blocks of a baked surface in space and in the atlas; the same for every light."""

    def __init__(self, scene: BakedScene) -> None:
        """Place the blocks of `scene`."""
        self._scene = scene
        transport = scene.transport
        self.texel, _ = coarse_blocks(transport.size, transport.texel_index)
        """First texel of every block, [block]."""
        self._half = -(-transport.size // 2)
        row, column = np.divmod(transport.texel_index[self.texel].astype(np.int64), transport.size)
        self._plane = np.full((self._half, self._half), -1, np.int32)
        self._plane[row // 2, column // 2] = np.arange(len(self.texel), dtype=np.int32)

    @cached_property
    def position(self) -> NDArray[np.float32]:
        """Where the light of every block was baked, [block, 3]."""
        return texel_positions(self._scene.mesh, self._scene.transport)[self.texel]

    @cached_property
    def side(self) -> float:
        """Length of a block's side on the surface, scene units; a mean over the surface."""
        corners = self._scene.mesh.vertices[self._scene.mesh.faces]
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = 0.5 * float(np.linalg.norm(doubled, axis=1).sum(dtype=np.float64))
        return 2.0 * (area / len(self._scene.transport.texel_index)) ** 0.5

    def around(
        self, position: NDArray[np.floating], normal: NDArray[np.floating], uv: NDArray[np.floating]
    ) -> BlockWeights:
        """Return the blocks around points at `position` with `normal` [point, 3], at `uv` [point, 2]."""
        # A block's light is that of its first texel, half a texel from its corner.
        place = 0.5 * (np.asarray(uv, np.float64) * self._scene.transport.size - 0.5)
        low = np.floor(place)
        fraction = (place - low).astype(np.float32)
        blocks, weights = [], []
        for down in (0, 1):
            for right in (0, 1):
                column, row = (low + np.array([right, down])).astype(np.int64).T
                inside = (column >= 0) & (column < self._half) & (row >= 0) & (row < self._half)
                block = self._plane[row * inside, column * inside]
                taken = inside & (block >= 0)
                block = np.where(taken, block, 0)
                apart = np.linalg.norm(self.position[block] - position, axis=1)
                facing = dot(self._scene.normal[self.texel[block]], normal)[:, 0]
                taken &= (apart < NEAR * self.side) & (facing > ALIKE)
                share = np.abs((1 - right) - fraction[:, 0]) * np.abs((1 - down) - fraction[:, 1])
                blocks.append(np.where(taken, block, 0))
                # A block at a distance of exactly one place counts for nothing, unless it is the only one.
                weights.append(np.where(taken, share + np.float32(1e-6), np.float32(0.0)))
        weight = np.stack(weights, axis=1)
        total = weight.sum(axis=1, keepdims=True)
        weight = (weight / np.where(total > 0.0, total, 1.0)).astype(np.float32)
        return BlockWeights(np.stack(blocks, axis=1).astype(np.int32), weight)
