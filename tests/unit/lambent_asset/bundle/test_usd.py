"""USDZ files, read back by USD."""

import io
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from lambent_asset.bundle.usd import write_usdz
from lambent_asset.textures.textures import base_colour_png
from lambent_core.errors import UsageError, WorkerError
from support.atlas_box import SIZES, atlas_box, coloured

BOX = atlas_box()


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("usd") / "new" / "asset.usdz"
    write_usdz(path, BOX, coloured(BOX))
    return path


@pytest.fixture(scope="module")
def stage(path):
    usd = pytest.importorskip("pxr.Usd")
    return usd.Stage.Open(str(path))


def test_axes_and_unit_are_stated(stage):
    from pxr import UsdGeom

    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    bounds = UsdGeom.BBoxCache(0.0, ["default"]).ComputeWorldBound(stage.GetDefaultPrim())
    assert np.allclose(bounds.ComputeAlignedRange().GetSize(), SIZES[[0, 2, 1]])
    turn = UsdGeom.XformCache().GetLocalToWorldTransform(stage.GetPrimAtPath("/asset/mesh"))
    # Row vectors: our +z becomes +y, and our +y becomes -z, as in the GLB.
    assert np.allclose(np.array([0.0, 0.0, 1.0, 0.0]) @ np.array(turn), [0.0, 1.0, 0.0, 0.0], atol=1e-6)
    assert np.allclose(np.array([0.0, 1.0, 0.0, 0.0]) @ np.array(turn), [0.0, 0.0, -1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (3.0, -2.0, 0.5), (-1.0, 7.0, -40.0)])
def test_the_object_stands_on_the_floor_at_the_origin_wherever_it_was_captured(tmp_path, offset):
    """A program for augmented reality puts the origin where the user taps on the floor."""
    usd, geometry = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdGeom")
    moved = replace(BOX, vertices=BOX.vertices + np.array(offset, np.float32))
    write_usdz(tmp_path / "asset.usdz", moved, coloured(BOX))
    stage = usd.Stage.Open(str(tmp_path / "asset.usdz"))
    bounds = geometry.BBoxCache(0.0, ["default"]).ComputeWorldBound(stage.GetDefaultPrim())
    found = bounds.ComputeAlignedRange()
    width, depth, height = SIZES
    assert np.allclose(found.GetMin(), [-width / 2.0, 0.0, -depth / 2.0], atol=1e-5)
    assert np.allclose(found.GetMax(), [width / 2.0, height, depth / 2.0], atol=1e-5)


def test_the_mesh_and_its_texture_coordinates_survive_with_v_upwards(stage):
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/asset/mesh"))
    assert np.array_equal(np.array(mesh.GetPointsAttr().Get()), BOX.vertices)
    assert np.array_equal(np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), BOX.faces)
    places = np.array(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get())
    assert np.allclose(places * [1.0, -1.0] + [0.0, 1.0], BOX.uv, atol=1e-6)


def test_every_channel_of_the_material_has_its_texture(stage):
    from pxr import UsdShade

    shader = UsdShade.Shader(stage.GetPrimAtPath("/asset/material/surface"))
    expected = {
        "diffuseColor": ("base_colour", "rgb", "sRGB"),
        "occlusion": ("packed", "r", "raw"),
        "roughness": ("packed", "g", "raw"),
        "metallic": ("packed", "b", "raw"),
        "normal": ("normal", "rgb", "raw"),
    }
    for name, (source, output, space) in expected.items():
        (connection,), _ = shader.GetInput(name).GetConnectedSources()
        found = UsdShade.Shader(connection.source.GetPrim())
        assert (found.GetPrim().GetName(), str(connection.sourceName)) == (source, output)
        assert found.GetInput("sourceColorSpace").Get() == space
    bound, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath("/asset/mesh")).ComputeBoundMaterial()
    assert bound.GetPath() == "/asset/material"


def test_the_textures_lie_in_the_archive_uncompressed(path):
    with zipfile.ZipFile(io.BytesIO(path.read_bytes())) as archive:
        stored = {entry.filename.rpartition("/")[2]: entry for entry in archive.infolist()}
        assert all(entry.compress_type == zipfile.ZIP_STORED for entry in stored.values())
        assert archive.read(stored["base_colour.png"]) == base_colour_png(coloured(BOX))
    assert set(stored) == {
        *("asset.usdc", "base_colour.png", "occlusion_roughness_metalness.png", "normal.png"),
    }


def test_without_the_package_the_message_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(UsageError, match=r"lambent\[usd\]") as raised:
        write_usdz(tmp_path / "a.usdz", BOX, coloured(BOX))
    assert raised.value.code == "export.usd_missing"


def test_a_file_that_usd_does_not_write_is_an_error(monkeypatch, tmp_path):
    utils = pytest.importorskip("pxr.UsdUtils")
    monkeypatch.setattr(utils, "CreateNewUsdzPackage", lambda *args: False)
    with pytest.raises(WorkerError) as raised:
        write_usdz(tmp_path / "a.usdz", BOX, coloured(BOX))
    assert raised.value.code == "export.usd"
