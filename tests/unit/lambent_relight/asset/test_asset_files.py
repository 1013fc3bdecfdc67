"""Assets as glTF, OBJ, Mitsuba's files and USDZ: every file holds the mesh and maps of the bundle."""

import io
import struct
import sys
from dataclasses import replace
from xml.dom import minidom

import numpy as np
import pytest
import trimesh
from lambent_asset.bundle.glb import write_glb
from lambent_asset.mesh.atlas import tangents
from lambent_core.colour import linear_from_srgb
from lambent_core.directions import uv_of_directions
from lambent_core.errors import ExportError
from lambent_relight import BundleError, load_bundle
from lambent_relight.asset.draco import DRACO, NORMAL_BITS, POSITION_BITS, glb_with_draco
from lambent_relight.asset.glb import WEBP, glb_with_textures
from lambent_relight.asset.mitsuba import ENVIRONMENT_TO_WORLD
from lambent_relight.asset.textured_mesh import (
    pixels_of,
    png_of,
    textured_mesh_from_glb,
    with_absolute_albedo,
)
from lambent_relight.asset.write import write_formats
from lambent_relight.baked.mesh import glb_chunks, mesh_from_glb
from PIL import Image
from support.asset_bundle import painted, write_asset_bundle
from support.atlas_box import atlas_box, coloured
from support.baked_bundle import glb as plain_glb
from support.spoilt_glb import spoilt_glb, with_document

BOX = atlas_box(32)
TEXTURES = coloured(BOX)
DATA = write_glb(BOX, TEXTURES, unit="unknown")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory):
    return write_asset_bundle(tmp_path_factory.mktemp("asset") / "box", BOX, TEXTURES)


@pytest.fixture(scope="module")
def written(bundle, tmp_path_factory):
    folder = tmp_path_factory.mktemp("written")
    files = write_formats(load_bundle(bundle), folder, ("glb", "obj", "mitsuba"))
    assert files == [folder / name for name in ("asset.glb", "obj/asset.obj", "mitsuba/scene.xml")]
    return folder


def test_a_textured_mesh_is_what_was_written():
    mesh = textured_mesh_from_glb(DATA)
    np.testing.assert_array_equal(mesh.vertices, BOX.vertices)
    np.testing.assert_array_equal(mesh.normals, BOX.normals)
    np.testing.assert_array_equal(mesh.faces, BOX.faces)
    np.testing.assert_array_equal(mesh.uv, BOX.uv)
    assert np.abs(linear_from_srgb(pixels_of(mesh.base_colour_png) / 255.0) - TEXTURES.albedo).max() < 0.01
    assert np.abs(pixels_of(mesh.packed_png) - np.array([191, 102, 255])).max() <= 1


def test_a_mesh_without_textures_is_refused():
    bare = plain_glb(BOX.vertices, BOX.faces, BOX.uv)
    with pytest.raises(BundleError, match=r"bundle\.mesh_invalid.*textures"):
        textured_mesh_from_glb(bare)


@pytest.mark.parametrize("png", [b"", b"\x89PNG\r\n\x1a\nnothing", b"GIF89a" + bytes(64)])
def test_a_texture_that_is_no_png_is_refused(png):
    mesh = replace(textured_mesh_from_glb(DATA), normal_png=png)
    with pytest.raises(BundleError, match=r"bundle\.mesh_invalid"):
        textured_mesh_from_glb(glb_with_textures(DATA, mesh))


def changed(change) -> bytes:
    """Return the file with another JSON chunk."""
    document, _ = glb_chunks(DATA)
    change(document)
    return with_document(DATA, document)


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["images"][1].update(bufferView=d["images"][0]["bufferView"]),
        lambda d: d["textures"][2].update(source=99),
        lambda d: d["bufferViews"][d["images"][0]["bufferView"]].update(byteLength=1 << 40),
        lambda d: d["bufferViews"][d["images"][0]["bufferView"]].update(byteOffset=-4),
        lambda d: d["meshes"][0]["primitives"][0]["attributes"].update(NORMAL=0, POSITION="x"),
        lambda d: d["bufferViews"].append({"buffer": 0, "byteOffset": 0, "byteLength": 1 << 40}),
        lambda d: d["bufferViews"].append({"buffer": 0, "byteOffset": 0}),
        lambda d: d["bufferViews"].append("a"),
        lambda d: d.pop("materials"),
    ],
)
def test_a_mesh_file_of_a_stranger_is_refused_and_no_crash(change):
    data = changed(change)
    with pytest.raises(BundleError, match=r"bundle\.mesh_invalid"):
        glb_with_textures(data, textured_mesh_from_glb(data), webp=True)


def exported(data):
    """Return what writing a stranger's file ends with; every other error fails the test."""
    try:
        glb_with_draco(glb_with_textures(data, textured_mesh_from_glb(data)))
    except BundleError as error:
        assert error.code == "bundle.mesh_invalid"  # noqa: PT017 - some files are refused, and some are written
        return "refused"
    return "written"


def test_no_value_in_the_file_ends_in_anything_but_a_refusal_or_a_file():
    rng = np.random.default_rng(11)
    ends = [exported(spoilt_glb(DATA, rng)) for _ in range(300)]
    assert 0 < ends.count("refused") < 300


def test_a_picture_outside_the_file_is_refused_for_draco():
    with pytest.raises(BundleError, match=r"bundle\.mesh_invalid"):
        glb_with_draco(changed(lambda d: d["images"].append({"uri": "far.png"})))


def test_absolute_albedo_is_scaled_in_linear_light_and_clipped_at_one():
    mesh = textured_mesh_from_glb(DATA)
    assert with_absolute_albedo(mesh, (1.0, 1.0, 1.0)) is mesh
    scaled = with_absolute_albedo(mesh, (0.5, 1.0, 3.0))
    expected = np.minimum(linear_from_srgb(pixels_of(mesh.base_colour_png) / 255.0) * [0.5, 1.0, 3.0], 1.0)
    found = linear_from_srgb(pixels_of(scaled.base_colour_png) / 255.0)
    assert np.abs(found - expected).max() < 0.005
    assert scaled.packed_png == mesh.packed_png


def test_the_albedo_of_every_format_is_absolute(tmp_path):
    folder = write_asset_bundle(tmp_path / "box", BOX, painted(BOX), albedo_scale=(0.5, 0.5, 0.5))
    write_formats(load_bundle(folder), tmp_path / "out", ("glb", "obj", "mitsuba"))
    pictures = [
        textured_mesh_from_glb((tmp_path / "out" / "asset.glb").read_bytes()).base_colour_png,
        *((tmp_path / "out" / name / "base_colour.png").read_bytes() for name in ("obj", "mitsuba")),
    ]
    for png in pictures:
        albedo = linear_from_srgb(pixels_of(png) / 255.0)
        np.testing.assert_allclose(albedo.mean(axis=(0, 1)), [0.35, 0.25, 0.15], atol=0.01)


def test_a_glb_keeps_everything_but_its_textures():
    mesh = replace(textured_mesh_from_glb(DATA), base_colour_png=png_of(np.zeros((32, 32, 3))))
    changed = glb_with_textures(DATA, mesh)
    again = textured_mesh_from_glb(changed)
    np.testing.assert_array_equal(again.vertices, BOX.vertices)
    np.testing.assert_array_equal(again.faces, BOX.faces)
    assert again.base_colour_png == mesh.base_colour_png
    assert again.normal_png == mesh.normal_png
    (before, _), (after, _) = glb_chunks(DATA), glb_chunks(changed)
    for name in ("asset", "nodes", "meshes", "materials", "textures", "samplers"):
        assert after[name] == before[name]


def test_webp_is_required_and_loses_nothing():
    mesh = textured_mesh_from_glb(DATA)
    data = glb_with_textures(DATA, mesh, webp=True)
    document, payload = glb_chunks(data)
    assert document["extensionsRequired"] == document["extensionsUsed"] == [WEBP]
    found = []
    for texture in document["textures"]:
        image = document["images"][texture["extensions"][WEBP]["source"]]
        assert "source" not in texture
        assert image["mimeType"] == "image/webp"
        view = document["bufferViews"][image["bufferView"]]
        file = payload[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        with Image.open(io.BytesIO(file), formats=("WEBP",)) as opened:
            found.append(np.asarray(opened.convert("RGB")))
    colour, packed, normal = found
    np.testing.assert_array_equal(colour, pixels_of(mesh.base_colour_png))
    np.testing.assert_array_equal(packed, pixels_of(mesh.packed_png))
    np.testing.assert_array_equal(normal, pixels_of(mesh.normal_png))
    np.testing.assert_array_equal(mesh_from_glb(data).vertices, BOX.vertices)


def corner_rows(points, uv, normals, tangents, faces):
    """Return what every corner of every triangle holds, [triangle, corner, 12], in an order of its own."""
    rows = np.concatenate([points, uv, normals, tangents], axis=1)[faces]
    # Triangles are told apart by their middles, their corners by their places; 1e-3 is far above rounding.
    rows = np.stack([row[np.lexsort(np.round(row[:, 2::-1].T, 3))] for row in rows])
    return rows[np.lexsort(np.round(rows.mean(axis=1)[:, 2::-1].T, 3))]


def test_another_library_unpacks_draco_to_the_same_corners():
    draco = pytest.importorskip("DracoPy", reason="needs the extra `draco`")
    data = glb_with_draco(DATA)
    document, payload = glb_chunks(data)
    assert document["extensionsRequired"] == document["extensionsUsed"] == [DRACO]
    (primitive,) = document["meshes"][0]["primitives"]
    packed = primitive["extensions"][DRACO]
    view = document["bufferViews"][packed["bufferView"]]
    mesh = draco.decode(payload[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    found = {attribute["unique_id"]: attribute["data"] for attribute in mesh.attributes}
    names = ("POSITION", "TEXCOORD_0", "NORMAL", "TANGENT")
    arrays = [found[packed["attributes"][name]] for name in names]
    for name, values in zip(names, arrays, strict=True):
        accessor = document["accessors"][primitive["attributes"][name]]
        assert accessor["count"] == len(values)
        assert accessor["type"] == f"VEC{values.shape[1]}"
        assert "bufferView" not in accessor
    assert document["accessors"][primitive["indices"]]["count"] == mesh.faces.size == BOX.faces.size
    frame = tangents(BOX.vertices, BOX.faces, BOX.uv, BOX.normals)
    wanted = corner_rows(BOX.vertices, BOX.uv, BOX.normals, frame, BOX.faces)
    error = np.abs(corner_rows(*arrays, mesh.faces) - wanted).max(axis=(0, 1))
    step = np.ptp(BOX.vertices, axis=0).max() / (2**POSITION_BITS - 1)
    assert error[:3].max() <= 0.51 * step
    assert error[3:5].max() <= 2.0**-16
    assert error[5:8].max() <= 4.0 * 2.0**-NORMAL_BITS
    np.testing.assert_array_equal(error[8:], 0.0)


def test_draco_and_webp_go_together_and_textures_stay(bundle, tmp_path):
    pytest.importorskip("DracoPy", reason="needs the extra `draco`")
    (plain,) = write_formats(load_bundle(bundle), tmp_path / "plain", ["glb"], webp=True)
    (path,) = write_formats(load_bundle(bundle), tmp_path / "packed", ["glb"], webp=True, draco=True)
    document, payload = glb_chunks(path.read_bytes())
    assert document["extensionsRequired"] == [WEBP, DRACO]
    before, content = glb_chunks(plain.read_bytes())
    for image, old in zip(document["images"], before["images"], strict=True):
        one, other = document["bufferViews"][image["bufferView"]], before["bufferViews"][old["bufferView"]]
        assert (
            payload[one["byteOffset"] : one["byteOffset"] + one["byteLength"]]
            == content[other["byteOffset"] : other["byteOffset"] + other["byteLength"]]
        )
    assert path.stat().st_size < plain.stat().st_size


def test_without_dracopy_the_option_says_what_to_install(bundle, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(ExportError, match=r"export\.draco_missing.*lambent\[draco\]"):
        write_formats(load_bundle(bundle), tmp_path / "out", ["glb"], draco=True)
    assert list((tmp_path / "out").iterdir()) == []


def test_a_mesh_that_draco_does_not_take_is_refused():
    pytest.importorskip("DracoPy", reason="needs the extra `draco`")
    with pytest.raises(BundleError, match=r"bundle\.mesh_invalid.*Draco"):
        glb_with_draco(changed(lambda d: d["meshes"][0]["primitives"][0]["attributes"].pop("TEXCOORD_0")))


def test_another_library_reads_the_obj_with_y_up_and_its_textures(written):
    found = trimesh.load(written / "obj" / "asset.obj", force="mesh", process=False, maintain_order=True)
    order = np.lexsort(found.vertices.T)
    expected = BOX.vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    np.testing.assert_allclose(found.vertices[order], expected[np.lexsort(expected.T)], atol=1e-6)
    assert found.volume == pytest.approx(6.0, rel=1e-5), "faces turn outwards"
    material = found.visual.material
    assert np.asarray(material.image.convert("RGB")).shape == (32, 32, 3)
    lines = (written / "obj" / "asset.obj").read_text().splitlines()
    places = np.array([line.split()[1:] for line in lines if line.startswith("vt ")], float)
    np.testing.assert_allclose(places, BOX.uv * [1.0, -1.0] + [0.0, 1.0], atol=1e-6)


def test_the_material_library_names_files_that_are_there(written):
    words = [line.split() for line in (written / "obj" / "asset.mtl").read_text().splitlines()]
    named = {line[0]: line[1] for line in words if len(line) == 2 and line[1].endswith(".png")}
    assert set(named) == {"map_Kd", "map_Pr", "map_Pm", "norm"}
    with Image.open(written / "obj" / named["map_Pr"]) as image:
        assert image.mode == "L"
        assert np.abs(np.asarray(image) - 102.0).max() <= 1
    with Image.open(written / "obj" / named["map_Pm"]) as image:
        assert np.asarray(image).min() == 255


def test_mitsubas_direction_at_a_place_of_the_map_is_ours():
    u, v = np.random.default_rng(0).uniform(0.02, 0.98, (2, 40))
    # Mitsuba 3, envmap: y up, atan2(x, -z) = 2 pi u.
    across = np.sin(np.pi * v)
    theirs = np.stack(
        [across * np.sin(2 * np.pi * u), np.cos(np.pi * v), -across * np.cos(2 * np.pi * u)], -1
    )
    found_u, found_v = uv_of_directions(theirs @ np.array(ENVIRONMENT_TO_WORLD, float)[:3, :3].T)
    np.testing.assert_allclose(np.exp(2j * np.pi * found_u), np.exp(2j * np.pi * u), atol=1e-6)
    np.testing.assert_allclose(found_v, v, atol=1e-6)


def test_the_scene_names_its_files_and_has_every_camera(bundle, written):
    scene = minidom.parseString((written / "mitsuba" / "scene.xml").read_bytes())  # noqa: S318 - our own

    def values(tag):
        return [
            (node.getAttribute("name"), node.getAttribute("value"))
            for node in scene.getElementsByTagName(tag)
        ]

    files = {value for name, value in values("string") if name == "filename"}
    defaults = dict(values("default"))
    for file in (files - {"$environment"}) | {defaults["environment"]}:
        assert (written / "mitsuba" / file).is_file(), file
    cameras = load_bundle(bundle).cameras()
    sensors = [node.getAttribute("id") for node in scene.getElementsByTagName("sensor")]
    assert sensors == [f"camera_{number}_{camera.name}" for number, camera in enumerate(cameras)]


def test_the_ply_file_has_the_mesh_in_world_axes(written):
    found = trimesh.load(written / "mitsuba" / "asset.ply", process=False)
    np.testing.assert_array_equal(found.vertices.astype(np.float32), BOX.vertices)
    np.testing.assert_array_equal(found.faces, BOX.faces)


def test_usd_is_written_without_complaints_and_validates(bundle, tmp_path, capfd):
    validation = pytest.importorskip("pxr.UsdValidation")
    from pxr import Usd

    (path,) = write_formats(load_bundle(bundle), tmp_path, ["usdz"])
    assert capfd.readouterr().err == ""
    validators = validation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    stage = Usd.Stage.Open(str(path))
    assert [error.GetMessage() for error in validation.ValidationContext(validators).Validate(stage)] == []


def test_a_scene_needs_light(tmp_path):
    folder = write_asset_bundle(tmp_path / "box", BOX, TEXTURES)
    opened = load_bundle(folder)
    del opened.manifest.train_lights[:]
    with pytest.raises(ExportError, match="--env"):
        write_formats(opened, tmp_path / "out", ["mitsuba"])
    assert not (tmp_path / "out").exists()


def test_an_unknown_format_is_refused(bundle, tmp_path):
    with pytest.raises(ExportError, match="glb, usdz, obj, mitsuba"):
        write_formats(load_bundle(bundle), tmp_path, ["fbx"])


def test_files_are_replaced_and_nothing_half_written_stays(bundle, tmp_path):
    (tmp_path / "obj").mkdir()
    (tmp_path / "obj" / "asset.obj").write_text("old")
    (tmp_path / "obj" / "notes.txt").write_text("mine")
    write_formats(load_bundle(bundle), tmp_path, ["obj"])
    assert (tmp_path / "obj" / "asset.obj").read_text().startswith("# y up")
    assert (tmp_path / "obj" / "notes.txt").read_text() == "mine"
    assert not list(tmp_path.glob(".partial*"))


def test_lengths_of_a_glb_add_up():
    data = glb_with_textures(DATA, textured_mesh_from_glb(DATA), webp=True)
    _, version, size = struct.unpack_from("<III", data, 0)
    assert (version, size) == (2, len(data))
    assert size % 4 == 0
