"""Levels of detail: the same atlas on fewer triangles, with smaller textures."""

import logging
from dataclasses import fields, replace

import fast_simplification
import numpy as np
from lambent_relight.baked.raster import block_means, nearest_texel, rasterise_uv
from numpy.typing import NDArray

from lambent_asset.mesh.atlas import unit
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.textures import TextureSet, tangent_normals

NUM_LEVELS = 2
SHARE = 0.5
"""Triangles of a level, of those of the level before it."""
FEWEST_FACES = 200
"""A level with fewer triangles than this is not made."""


class LostVertexError(Exception):
    """A coarser mesh has a vertex of which is not known what it stands for."""


def levels_of_detail(surface: AtlasSurface) -> list[AtlasSurface]:
    """Return coarser versions of `surface`, each with about `SHARE` of the triangles of the one before.

    Borders of charts stay as they are, so that charts do not part and every texture fits every level; where
    they leave little to save there are fewer levels.
    """
    levels: list[AtlasSurface] = []
    count = float(len(surface.faces))
    for _ in range(NUM_LEVELS):
        count *= SHARE
        previous = levels[-1] if levels else surface
        if count < FEWEST_FACES:
            break
        try:
            level = coarser(surface, int(count))
        except LostVertexError:
            # A level is a convenience: the mesh does without.
            logging.getLogger(__name__).warning("mesh.level_left_out: %d triangles", int(count))
            break
        if len(level.faces) > 0.75 * len(previous.faces):
            break
        levels.append(level)
    return levels


def coarser(surface: AtlasSurface, num_faces: int) -> AtlasSurface:
    """Return `surface` with about `num_faces` triangles, or more where its charts have long borders.

    A vertex that moved has the texture coordinates and the normal of the nearest place on the triangles that
    it stands for, which belong to its chart.
    """
    vertices, faces, collapses = fast_simplification.simplify(
        np.ascontiguousarray(surface.vertices, np.float64),
        np.ascontiguousarray(surface.faces, np.int32),
        target_count=num_faces,
        preserve_border=True,
        return_collapses=True,
    )
    vertices, faces, target = fast_simplification.replay_simplification(
        np.ascontiguousarray(surface.vertices, np.float64),
        np.ascontiguousarray(surface.faces, np.int32),
        np.ascontiguousarray(collapses, np.int32),
    )
    face, weights = _nearest_on_faces(np.asarray(vertices, np.float64), surface, np.asarray(target))
    corners = surface.faces[face]

    def carried(values: NDArray[np.floating]) -> NDArray[np.float32]:
        return np.einsum("vk,vkn->vn", weights, values[corners]).astype(np.float32)

    uv, normals = carried(surface.uv), unit(carried(surface.normals)).astype(np.float32)
    faces = np.asarray(faces, np.int32)
    fragments = rasterise_uv(uv, faces, surface.size)
    index = np.flatnonzero(fragments.covered).astype(np.int32)
    owner = nearest_texel(surface.texel_index, surface.size).reshape(-1)[index]
    return replace(
        surface,
        vertices=np.asarray(vertices, np.float32),
        faces=faces,
        uv=uv,
        normals=normals,
        texel_index=index,
        positions=surface.positions[owner],
        texel_normals=surface.texel_normals[owner],
        unseen=surface.unseen[owner] if len(surface.unseen) else surface.unseen,
    )


def level_textures(textures: TextureSet, level: AtlasSurface, factor: int) -> TextureSet:
    """Return the textures of a level, of whatever size, as means over `factor` x `factor` texels.

    Normals are expressed in the level's own frames before.
    """
    owner = nearest_texel(level.texel_index, level.size)
    textures = replace(textures, tangent_normal=tangent_normals(level)[owner])
    small = {
        plane.name: block_means(getattr(textures, plane.name), factor).astype(np.float32)
        for plane in fields(textures)
    }
    small["tangent_normal"] = unit(small["tangent_normal"]).astype(np.float32)
    return TextureSet(**small)


def _nearest_on_faces(
    vertices: NDArray[np.float64], surface: AtlasSurface, target: NDArray[np.integer]
) -> tuple[NDArray[np.integer], NDArray[np.float64]]:
    """Return for each new vertex a face of `surface` and the weights of its corners at the nearest place.

    `target` is the new vertex of each old one; faces of the old ones are looked at.
    """
    pairs = np.stack(
        [target[surface.faces].reshape(-1), np.repeat(np.arange(len(surface.faces)), 3)], axis=-1
    )
    pairs = np.unique(pairs[(pairs[:, 0] >= 0) & (pairs[:, 0] < len(vertices))], axis=0)
    vertex, face = pairs.T
    weights = _closest_weights(vertices[vertex], surface.vertices[surface.faces[face]].astype(np.float64))
    places = np.einsum("pk,pkn->pn", weights, surface.vertices[surface.faces[face]].astype(np.float64))
    away = np.linalg.norm(places - vertices[vertex], axis=1)
    order = np.lexsort((away, vertex))
    first = order[np.unique(vertex[order], return_index=True)[1]]
    if len(first) != len(vertices):
        raise LostVertexError("a vertex of a level stands for none of the mesh")
    return face[first], weights[first]


def _closest_weights(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return barycentric weights [point, 3] of the place of each triangle nearest to its point."""
    a = corners[:, 0]
    edges = corners[:, 1:] - a[:, None]
    gram = np.einsum("pin,pjn->pij", edges, edges)
    right = np.einsum("pin,pn->pi", edges, points - a)
    determinant = gram[:, 0, 0] * gram[:, 1, 1] - gram[:, 0, 1] ** 2
    safe = np.where(determinant > 0.0, determinant, 1.0)
    second = (gram[:, 1, 1] * right[:, 0] - gram[:, 0, 1] * right[:, 1]) / safe
    third = (gram[:, 0, 0] * right[:, 1] - gram[:, 0, 1] * right[:, 0]) / safe
    inside = (determinant > 0.0) & (second >= 0.0) & (third >= 0.0) & (second + third <= 1.0)
    best = np.stack([1.0 - second - third, second, third], axis=-1)
    away = np.where(inside, 0.0, np.inf)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        start, along = corners[:, i], corners[:, j] - corners[:, i]
        length = np.maximum((along * along).sum(-1), 1e-300)
        share = (((points - start) * along).sum(-1) / length).clip(0.0, 1.0)
        distance = np.linalg.norm(start + share[:, None] * along - points, axis=1)
        nearer = ~inside & (distance < away)
        on_edge = np.zeros_like(best)
        on_edge[:, i], on_edge[:, j] = 1.0 - share, share
        best[nearer], away = on_edge[nearer], np.where(nearer, distance, away)
    return best
