"""The surface of a training as a USDZ file. Needs the extra [usd]."""

from pathlib import Path

from lambent_core.errors import ExportError, UsageError, WorkerError
from lambent_relight.asset.textured_mesh import TexturedMesh
from lambent_relight.asset.usdz import write_usdz as write_textured_mesh

from lambent_asset.textures import textures as baked
from lambent_asset.textures.surface import AtlasSurface
from lambent_asset.textures.textures import TextureSet


def write_usdz(path: Path, surface: AtlasSurface, textures: TextureSet) -> None:
    """Write `surface` with its textures as a USDZ file at `path`; normals per vertex and a normal map.

    Raises UsageError where the package usd-core is missing, WorkerError where USD refuses the file.
    """
    mesh = TexturedMesh(
        vertices=surface.vertices,
        normals=surface.normals,
        faces=surface.faces,
        uv=surface.uv,
        base_colour_png=baked.base_colour_png(textures),
        packed_png=baked.occlusion_roughness_metalness_png(textures),
        normal_png=baked.normal_png(textures),
    )
    try:
        write_textured_mesh(path, mesh)
    except ExportError as error:
        kind = UsageError if error.code == "export.usd_missing" else WorkerError
        raise kind(error.code, f"{error.message}; {error.advice}") from error
