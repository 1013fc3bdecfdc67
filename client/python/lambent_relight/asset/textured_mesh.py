"""The mesh of a bundle with its textures, as other formats need it.

World coordinates (z up, scene units); u to the right and v down from the top row of the textures.
Source: docs/reference/bundle-format.md (mesh). The file may come from an untrusted source.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from numpy.typing import NDArray
from PIL import Image

from lambent_relight.baked.mesh import mesh_from_glb
from lambent_relight.baked.mesh_textures import pixels_of, texture_files


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TexturedMesh:
    """Triangles and three square textures as PNG files."""

    vertices: NDArray[np.float32]
    """[vertex, 3], scene units."""
    normals: NDArray[np.float32]
    """Unit, outwards, [vertex, 3]."""
    faces: NDArray[np.int32]
    """[face, 3], counter-clockwise seen from outside."""
    uv: NDArray[np.float32]
    """[vertex, 2]."""
    base_colour_png: bytes
    """sRGB-encoded albedo."""
    packed_png: bytes
    """Linear: occlusion in red, perceptual roughness in green, metalness in blue."""
    normal_png: bytes
    """Tangent space, -1..1 as 0..1, +y towards the top of the texture."""


def textured_mesh_from_glb(data: bytes) -> TexturedMesh:
    """Return mesh and textures of a bundle's mesh/asset.glb.

    Raises BundleError `bundle.mesh_invalid` for a file that cannot be read, and for one without textures.
    """
    mesh = mesh_from_glb(data)
    colour, packed, bent = texture_files(data)
    assert mesh.normals is not None, "every mesh of a bundle has normals"
    return TexturedMesh(
        vertices=mesh.vertices,
        normals=mesh.normals,
        faces=mesh.faces,
        uv=mesh.uv,
        base_colour_png=colour,
        packed_png=packed,
        normal_png=bent,
    )


def with_absolute_albedo(mesh: TexturedMesh, scale_rgb: Sequence[float]) -> TexturedMesh:
    """Return the mesh with its albedo times `scale_rgb`, clipped to [0, 1] as when it is rendered."""
    if np.allclose(scale_rgb, 1.0, atol=1e-6):
        return mesh
    albedo = linear_from_srgb(pixels_of(mesh.base_colour_png) / 255.0) * np.asarray(scale_rgb)
    return replace(mesh, base_colour_png=png_of(srgb_from_linear(albedo)))


def png_of(values: NDArray[np.floating]) -> bytes:
    """Return values in [0, 1], [height, width] or [height, width, 3], as an 8-bit PNG file."""
    file = io.BytesIO()
    Image.fromarray(np.round(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)).save(file, format="PNG")
    return file.getvalue()
