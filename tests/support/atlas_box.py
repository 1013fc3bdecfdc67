"""A box with an atlas of known layout, and textures of known colours."""

import numpy as np
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.textures import TextureSet, tangent_normals
from lambent_relight.baked.raster import interpolate, nearest_texel, rasterise_uv

SIZES = np.array([1.0, 2.0, 3.0])
FACE_COLOURS = np.array(
    [[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9], [0.8, 0.8, 0.1], [0.1, 0.8, 0.8], [0.5, 0.2, 0.0]]
)
"""Linear, of the faces -x, +x, -y, +y, -z, +z."""


def atlas_box(size: int = 64) -> AtlasSurface:
    """Return a box of `SIZES` around the origin, a chart for each face, three in each of two rows."""
    vertices, faces, uv, normals = [], [], [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            number = len(faces) // 2
            normal = np.zeros(3)
            normal[axis] = side
            right = np.roll([1.0, 0.0, 0.0], axis + 1)
            up = np.cross(normal, right)
            origin = np.array([(number % 3) / 3.0, (number // 3) / 2.0])
            for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)):
                vertices.append((normal + x * right + y * up) * SIZES / 2.0)
                normals.append(normal)
                # The charts of every other face are mirrored, so that both kinds of tangent frames occur.
                u = 0.5 + 0.4 * x * (1 if number % 2 else -1)
                uv.append(origin + np.array([u / 3.0, (0.5 - 0.4 * y) / 2.0]))
            faces += [
                [4 * number, 4 * number + 1, 4 * number + 2],
                [4 * number, 4 * number + 2, 4 * number + 3],
            ]
    vertices, uv, normals = (np.array(values, np.float32) for values in (vertices, uv, normals))
    faces = np.array(faces, np.int32)
    found = rasterise_uv(uv, faces, size)
    return AtlasSurface(
        vertices=vertices,
        faces=faces,
        uv=uv,
        normals=normals,
        size=size,
        texel_index=np.flatnonzero(found.covered).astype(np.int32),
        positions=interpolate(found, faces, vertices),
        texel_normals=interpolate(found, faces, normals),
        cell=0.05,
    )


def coloured(surface: AtlasSurface, albedo: np.ndarray | None = None) -> TextureSet:
    """Return textures with `albedo` [texel, 3], by default a colour per face, and one material."""
    owner = nearest_texel(surface.texel_index, surface.size)
    if albedo is None:
        found = rasterise_uv(surface.uv, surface.faces, surface.size)
        albedo = FACE_COLOURS[found.face[found.covered] // 2]

    def everywhere(value: float) -> np.ndarray:
        return np.full((surface.size, surface.size, 1), value, np.float32)

    return TextureSet(
        albedo=albedo.astype(np.float32)[owner],
        perceptual_roughness=everywhere(0.4),
        metalness=everywhere(1.0),
        occlusion=everywhere(0.75),
        tangent_normal=tangent_normals(surface)[owner],
    )
