"""The albedo texture: the model's colours with the photographs' detail.

Two passes over the photographs, one in memory at a time. The first looks at every photograph at the surface's
nodes and decides which of them gives the detail of which part (`photo_choice`). The second looks the detail
up for every texel there. Radiance becomes albedo by the shading that baked transport predicts under the
recovered light (`photo_shading`); what is broader than a few nodes keeps the model's value.
"""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int
from lambent_core.scene import View
from lambent_relight.baked.raster import Fragments, interpolate, nearest_texel, rasterise_uv
from lambent_relight.baked.scene import BakedScene
from lambent_relight.baked.texture_lookup import bilinear
from numpy import ndarray

from lambent_asset.mesh.mesh import Mesh
from lambent_asset.textures.photo_choice import Choice, Observations, choose
from lambent_asset.textures.photo_nodes import Nodes, nodes_of
from lambent_asset.textures.photo_shading import LitSurface, SurfaceUnderLight
from lambent_asset.textures.photo_view import Photograph
from lambent_asset.textures.surface import AtlasSurface

LEAST_SIZE = 1024
"""Texels along a side of the smallest texture that is chosen automatically."""
LARGEST_SIZE = {"lite": 1024, "full": 4096, "none": 4096}
"""Texels along a side of the largest, by tier: a lite bundle should have 10 MB, and an albedo of 4096 alone
has more."""
ROWS_AT_ONCE = 256
LEAST_WEIGHT = 1e-3
_LEAST_GAIN = 0.02
"""Radiance of white below which albedo cannot be measured, relative to the surface's mean."""
_MOST_OFFSET = 0.7
"""Share of the observed radiance that a predicted reflection may take."""
_GLOSS = (0.25, 0.5)
"""Perceptual roughness below which a metal's reflections hide its colour, and from which on they do not."""

Photographs = Callable[[], Iterable[View]]


@dataclass(frozen=True, slots=True, eq=False)
class FineTexels:
    """The covered texels of a texture that is finer than the model."""

    size: int
    index: Int[ndarray, " texels"]
    """Row-major places, ascending."""
    positions: Float32[ndarray, "texels 3"]

    def uv(self, part: slice | Int[ndarray, " some"]) -> Float32[ndarray, "some 2"]:
        """Return the centres of some texels."""
        row, column = np.divmod(self.index[part], self.size)
        return ((np.stack([column, row], axis=-1) + 0.5) / self.size).astype(np.float32)


def automatic_size(surface: AtlasSurface, pixel: float, tier: str) -> int:
    """Return the power of two at which a texel is about a pixel of the photographs, up to `LARGEST_SIZE`.

    `tier` is that of the bundle, "full", "lite" or "none"; `pixel` is the footprint of a pixel at the object,
    scene units; 0: unknown.
    """
    wanted = surface.size * surface.texel_size / pixel if pixel > 0.0 else 0.0
    size = LEAST_SIZE
    # Below the size of transport charts would run together, whatever the tier.
    while size < surface.size or size < min(LARGEST_SIZE[tier], 0.75 * wanted):
        size *= 2
    return size


def fine_texels(surface: AtlasSurface, size: int) -> FineTexels:
    """Return the covered texels of a texture of `size` texels a side, on the trained surface."""
    fragments = rasterise_uv(surface.uv, surface.faces, size)
    index = np.flatnonzero(fragments.covered).astype(np.int32)
    coarse = rasterise_uv(surface.uv, surface.faces, surface.size)
    moved = surface.positions - interpolate(coarse, surface.faces, surface.vertices)
    moved = moved[nearest_texel(surface.texel_index, surface.size)]
    positions = np.empty((len(index), 3), np.float32)
    texels, first = FineTexels(size, index, positions), 0
    for row in range(0, size, ROWS_AT_ONCE):
        band = slice(row, row + ROWS_AT_ONCE)
        part = Fragments(fragments.face[band], fragments.barycentric[band], fragments.depth[band])
        on_mesh = interpolate(part, surface.faces, surface.vertices)
        rows = slice(first, first + len(on_mesh))
        positions[rows] = on_mesh + bilinear(moved, texels.uv(rows))
        first += len(on_mesh)
    return texels


def albedo_texture(
    surface: AtlasSurface,
    scene: BakedScene,
    size: int,
    photographs: Photographs,
    light: str,
    radiance: Float32[ndarray, "rows columns 3"],
    advance: Callable[[], None] = lambda: None,
) -> tuple[Float32[ndarray, "size size 3"], dict[str, float]]:
    """Return linear albedo of `size` x `size` texels, gutters filled, and figures of how it was made.

    `scene` is the baked surface, with the model's materials; `photographs` opens the views, whose pictures of
    `light` are used, and `radiance` is the map recovered for it. `advance` is called after each photograph
    and may raise to stop. Memory: 40 bytes for each texel of the texture, 40 for each node and photograph
    while they are chosen and 27 afterwards, and one photograph with two reduced copies.
    """
    nodes = nodes_of(surface.size, surface.texel_index, surface.positions, surface.texel_normals)
    under = SurfaceUnderLight(scene, radiance)
    mesh = Mesh(surface.vertices, surface.faces, surface.cell)
    texel = surface.texel_size * surface.size / size
    seen = []
    for view in photographs():
        photograph = Photograph(view, light)
        seen.append(observe(photograph, under.turned(photograph.turn), nodes, mesh, texel))
        # Not to be in memory while the next one is read.
        del view, photograph
        advance()
    choices = choose(nodes, seen, scene.albedo[nodes.texel])
    fine = fine_texels(surface, size)
    total, weight = np.zeros((len(fine.index), 3), np.float32), np.zeros(len(fine.index), np.float32)
    # No loop over the photographs by `zip`: it keeps the last one while it asks for the next.
    opened = iter(photographs())
    for choice in choices:
        view = next(opened)
        if (choice.weight > LEAST_WEIGHT).any():
            photograph = Photograph(view, light)
            lit = under.turned(photograph.turn)
            add_detail(photograph, lit, nodes, choice, fine, total, weight, texel)
            del photograph
        del view
        advance()
    plane = scene.albedo[nearest_texel(surface.texel_index, surface.size)]
    for first in range(0, len(weight), 1 << 20):
        part = slice(first, first + (1 << 20))
        total[part] += np.maximum(1.0 - weight[part], 0.0)[:, None] * bilinear(plane, fine.uv(part))
        total[part] /= np.maximum(weight[part], 1.0)[:, None]
    np.clip(total, 0.0, 1.0, out=total)
    figures = {
        "texture_photograph_share": float(weight.mean()),
        "texture_photographs": float(sum(bool((choice.weight > 0.5).any()) for choice in choices)),
    }
    logging.getLogger(__name__).info("texture.made: %s", figures)
    return total[nearest_texel(fine.index, size)], figures


def observe(photograph: Photograph, lit: LitSurface, nodes: Nodes, mesh: Mesh, texel: float) -> Observations:
    """Return what a photograph says about the nodes, for a texture with texels of `texel` scene units."""
    points = photograph.see(nodes.positions, nodes.normals, mesh)
    node = np.flatnonzero(points.visible).astype(np.int32)
    places, resolution = points.places[node], points.resolution[node]
    scale = float(np.median(resolution)) if len(node) else 0.0
    fine, coarse = photograph.reduced(texel * scale), photograph.reduced(nodes.spacing * scale)
    observed = coarse.at(places)
    gain, offset = lit.linear_in_albedo(nodes.texel[node], points.omega_o[node])
    offset = np.minimum(offset, _MOST_OFFSET * observed)
    bright = gain.mean(axis=1)
    trust = bright / (bright + offset.mean(axis=1) + _LEAST_GAIN * max(float(lit.diffuse.mean()), 1e-6))
    metal, roughness = (
        values[nodes.texel[node], 0] for values in (lit.scene.metalness, lit.scene.perceptual_roughness)
    )
    dull = np.clip((roughness - _GLOSS[0]) / (_GLOSS[1] - _GLOSS[0]), 0.0, 1.0)
    trust *= 1.0 - metal * (1.0 - dull)
    albedo = (observed - offset) / np.maximum(gain, _LEAST_GAIN * max(float(lit.diffuse.mean()), 1e-6))
    size = np.array([fine.image.shape[1], fine.image.shape[0]], np.float32) * fine.factor
    block = max(1, coarse.factor // fine.factor)
    detail = bilinear(_pooled(fine.detail(), block), places / size)[:, 0]
    return Observations(
        node,
        np.clip(albedo, 1e-3, 2.0).astype(np.float32),
        resolution * np.float32(texel),
        np.where(trust > LEAST_WEIGHT, trust, 0.0).astype(np.float32),
        detail,
    )


def add_detail(
    photograph: Photograph,
    lit: LitSurface,
    nodes: Nodes,
    choice: Choice,
    fine: FineTexels,
    total: Float32[ndarray, "texels 3"],
    weight: Float32[ndarray, " texels"],
    texel: float,
) -> None:
    """Add what a photograph says about the texels for which it was chosen to `total`, and `weight` to it."""
    # Its neighbours too: texels lie between nodes.
    on = np.flatnonzero(nodes.blurred(choice.weight[:, None], 1)[:, 0] > 0.0)
    normals, position = nodes.normals[on], nodes.positions[on]
    towards = photograph.camera.position.astype(np.float32) - position
    distance = np.linalg.norm(towards, axis=1)
    omega_o = (towards / distance[:, None]).astype(np.float32)
    resolution = photograph.camera.focal_x / distance * np.maximum((normals * omega_o).sum(-1), 0.0)
    level = photograph.reduced(texel * float(np.median(resolution)))
    gain, offset = np.ones((len(nodes.texel), 3), np.float32), np.zeros((len(nodes.texel), 3), np.float32)
    gain[on], offset[on] = lit.linear_in_albedo(nodes.texel[on], omega_o)
    least = _LEAST_GAIN * max(float(lit.diffuse.mean()), 1e-6)
    planes = np.concatenate([choice.weight[:, None], choice.level, gain, offset], axis=1)[nodes.owner]
    for first in range(0, len(weight), 1 << 20):
        uv = fine.uv(slice(first, first + (1 << 20)))
        share = bilinear(planes[..., :1], uv)[:, 0]
        some = np.flatnonzero(share > LEAST_WEIGHT)
        if not len(some):
            continue
        here = first + some
        values = bilinear(planes[..., 1:], uv[some])
        places, _ = photograph.project(fine.positions[here])
        observed = level.sharp_at(places)
        reflected = np.minimum(values[:, 6:], _MOST_OFFSET * observed)
        albedo = (observed - reflected) / np.maximum(values[:, 3:6], least) * values[:, :3]
        total[here] += share[some, None] * np.clip(albedo, 0.0, 1.0)
        weight[here] += share[some]


def _pooled(values: Float32[ndarray, "rows columns 1"], block: int) -> Float32[ndarray, "_ _ 1"]:
    """Return means over blocks of `block` x `block`, or over all where there are fewer."""
    block = max(1, min(block, *values.shape[:2]))
    rows, columns = values.shape[0] // block, values.shape[1] // block
    cut = values[: rows * block, : columns * block]
    return cut.reshape(rows, block, columns, block, 1).mean(axis=(1, 3))
