"""Writes the asset of a bundle in the formats that other programs read."""

import os
import tempfile
from collections.abc import Collection
from pathlib import Path

from lambent_core.errors import ExportError

from lambent_relight.asset.draco import glb_with_draco
from lambent_relight.asset.glb import glb_with_textures
from lambent_relight.asset.mitsuba import write_mitsuba
from lambent_relight.asset.obj import write_obj
from lambent_relight.asset.textured_mesh import textured_mesh_from_glb, with_absolute_albedo
from lambent_relight.asset.usdz import write_usdz
from lambent_relight.baked.mesh import MESH_PATH
from lambent_relight.bundle.bundle import Bundle
from lambent_relight.environment.maps import Environment

FORMATS = ("glb", "usdz", "obj", "mitsuba")
_MAX_BYTES = 512 << 20


def write_formats(
    bundle: Bundle,
    folder: Path,
    formats: Collection[str],
    *,
    environment: Environment | None = None,
    webp: bool = False,
    ktx2: bool = False,
    draco: bool = False,
) -> list[Path]:
    """Write the asset of `bundle` into `folder` and return the main file of each of `formats`.

    glb: asset.glb; usdz: asset.usdz; obj: obj/asset.obj; mitsuba: mitsuba/scene.xml, lit by `environment`,
    by default the one recovered for the first training light. Albedo is multiplied by the bundle's
    `albedo_scale_rgb` as when it is rendered. `webp` or `ktx2` (textures) and `draco` (mesh) are for the GLB.
    Files of those names are replaced, each by a whole one. Raises BundleError for a mesh without textures,
    ExportError where a format needs what is not there, and for `webp` together with `ktx2`.
    """
    if webp and ktx2:
        raise ExportError(
            "export.textures",
            "webp=True and ktx2=True were both given, but the GLB's textures are one of the two",
            "leave one of them out",
        )
    if unknown := set(formats) - set(FORMATS):
        raise ExportError(
            "export.format", f"unknown formats {sorted(unknown)}", f"use some of {', '.join(FORMATS)}"
        )
    data = bundle.read(MESH_PATH, _MAX_BYTES)
    mesh = with_absolute_albedo(textured_mesh_from_glb(data), list(bundle.manifest.albedo_scale_rgb))
    light = (environment or _recovered(bundle)) if "mitsuba" in formats else None
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with tempfile.TemporaryDirectory(prefix=".partial-", dir=folder) as name:
        partial = Path(name)
        if "glb" in formats:
            glb = glb_with_textures(data, mesh, webp=webp, ktx2=ktx2)
            (partial / "asset.glb").write_bytes(glb_with_draco(glb) if draco else glb)
            written.append(folder / "asset.glb")
        if "usdz" in formats:
            write_usdz(partial / "asset.usdz", mesh)
            written.append(folder / "asset.usdz")
        if "obj" in formats:
            write_obj(partial / "obj", mesh)
            written.append(folder / "obj" / "asset.obj")
        if light is not None:
            write_mitsuba(partial / "mitsuba", mesh, light, bundle.cameras())
            written.append(folder / "mitsuba" / "scene.xml")
        for path in sorted(path for path in partial.rglob("*") if path.is_file()):
            target = folder / path.relative_to(partial)
            target.parent.mkdir(exist_ok=True)
            os.replace(path, target)
    return written


def _recovered(bundle: Bundle) -> Environment:
    lights = list(bundle.manifest.train_lights)
    if not lights or all(file.path != f"env/trained_{lights[0]}.exr" for file in bundle.manifest.files):
        raise ExportError(
            "export.no_environment",
            "the bundle has no recovered environment to light a Mitsuba scene with",
            "give one with --env",
        )
    return bundle.trained_environment(lights[0])
