"""A textured mesh as a USDZ file, for programs that read USD and not glTF. Needs the extra [usd].

UsdPreviewSurface. The stage is y up, as ARKit requires; points stay in the world's axes (z up), and the root
turns them, as the node of the GLB does. It also moves them: programs for augmented reality put the origin of
the stage on the floor, so the object's lowest point is at y = 0, and its middle at x = z = 0. USD counts
texture rows from the bottom, so v is turned.
Source: OpenUSD, UsdPreviewSurface specification 2.6; USDZ file format specification.
"""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.errors import ExportError, pip_install

from lambent_relight.asset.textured_mesh import TexturedMesh

METRES_PER_UNIT = 1.0
"""Metres per scene unit where that is unknown, as glTF readers assume."""


def write_usdz(path: Path, surface: TexturedMesh) -> None:
    """Write `surface` with its textures as a USDZ file at `path`; normals per vertex and a normal map.

    Raises ExportError: `export.usd_missing` where the package usd-core is missing, `export.usd` where USD
    refuses the file.
    """
    usd = _usd()
    files = {
        "base_colour.png": surface.base_colour_png,
        "occlusion_roughness_metalness.png": surface.packed_png,
        "normal.png": surface.normal_png,
    }
    with tempfile.TemporaryDirectory(prefix="lambent-") as name:
        folder = Path(name)
        for file, data in files.items():
            (folder / file).write_bytes(data)
        layer = folder / "asset.usdc"
        _write_stage(usd, layer, surface)
        path.parent.mkdir(parents=True, exist_ok=True)
        made = usd.UsdUtils.CreateNewUsdzPackage(usd.Sdf.AssetPath(str(layer)), str(path))
    if not made:
        raise ExportError(
            "export.usd",
            f'USD did not write "{path}"',
            "check that the folder can be written to and is not full",
        )


def _usd() -> Any:
    try:
        import pxr.Sdf
        import pxr.UsdGeom
        import pxr.UsdShade
        import pxr.UsdUtils
    except ImportError as error:
        raise ExportError(
            "export.usd_missing",
            "USDZ files need the package usd-core, which is not here",
            pip_install("usd"),
        ) from error
    return pxr


def _write_stage(usd: Any, path: Path, surface: TexturedMesh) -> None:
    stage = usd.Usd.Stage.CreateNew(str(path))
    usd.UsdGeom.SetStageUpAxis(stage, usd.UsdGeom.Tokens.y)
    usd.UsdGeom.SetStageMetersPerUnit(stage, METRES_PER_UNIT)
    root = usd.UsdGeom.Xform.Define(stage, "/asset")
    corners = np.stack([surface.vertices.min(axis=0), surface.vertices.max(axis=0)])
    middle = corners.astype(np.float64).mean(axis=0)
    # The last operation is applied first: a quarter turn about x brings +z to +y and +y to -z.
    root.AddTranslateOp().Set((-middle[0], -float(corners[0, 2]), middle[1]))
    root.AddRotateXOp().Set(-90.0)
    stage.SetDefaultPrim(root.GetPrim())
    mesh = usd.UsdGeom.Mesh.Define(stage, "/asset/mesh")
    vec3 = usd.Vt.Vec3fArray.FromNumpy
    mesh.CreatePointsAttr(vec3(np.ascontiguousarray(surface.vertices, np.float32)))
    mesh.CreateFaceVertexCountsAttr(usd.Vt.IntArray.FromNumpy(np.full(len(surface.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(
        usd.Vt.IntArray.FromNumpy(np.ascontiguousarray(surface.faces.ravel(), np.int32))
    )
    mesh.CreateNormalsAttr(vec3(np.ascontiguousarray(surface.normals, np.float32)))
    mesh.SetNormalsInterpolation(usd.UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(usd.UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(vec3(corners.astype(np.float32)))
    places = surface.uv * np.array([1.0, -1.0], np.float32) + np.array([0.0, 1.0], np.float32)
    primvar = usd.UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", usd.Sdf.ValueTypeNames.TexCoord2fArray, usd.UsdGeom.Tokens.vertex
    )
    primvar.Set(usd.Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(places)))
    _bind_material(usd, stage, mesh)
    stage.GetRootLayer().Save()


def _bind_material(usd: Any, stage: Any, mesh: Any) -> None:
    types = usd.Sdf.ValueTypeNames
    material = usd.UsdShade.Material.Define(stage, "/asset/material")
    surface = usd.UsdShade.Shader.Define(stage, "/asset/material/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("useSpecularWorkflow", types.Int).Set(0)
    reader = usd.UsdShade.Shader.Define(stage, "/asset/material/places")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    place = reader.CreateOutput("result", types.Float2)

    def texture(name: str, file: str, space: str) -> Any:
        shader = usd.UsdShade.Shader.Define(stage, f"/asset/material/{name}")
        shader.CreateIdAttr("UsdUVTexture")
        shader.CreateInput("file", types.Asset).Set(f"./{file}")
        shader.CreateInput("sourceColorSpace", types.Token).Set(space)
        for wrap in ("wrapS", "wrapT"):
            shader.CreateInput(wrap, types.Token).Set("clamp")
        shader.CreateInput("st", types.Float2).ConnectToSource(place)
        return shader

    def connect(name: str, kind: Any, shader: Any, output: str) -> None:
        made = shader.GetOutput(output) or shader.CreateOutput(output, kind)
        surface.CreateInput(name, kind).ConnectToSource(made)

    colour = texture("base_colour", "base_colour.png", "sRGB")
    connect("diffuseColor", types.Color3f, colour, "rgb")
    packed = texture("packed", "occlusion_roughness_metalness.png", "raw")
    for name, channel in (("occlusion", "r"), ("roughness", "g"), ("metallic", "b")):
        connect(name, types.Float, packed, channel)
    normal = texture("normal", "normal.png", "raw")
    normal.CreateInput("scale", types.Float4).Set((2.0, 2.0, 2.0, 1.0))
    normal.CreateInput("bias", types.Float4).Set((-1.0, -1.0, -1.0, 0.0))
    connect("normal", types.Normal3f, normal, "rgb")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    usd.UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
