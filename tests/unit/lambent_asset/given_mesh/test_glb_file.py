"""A GLB of another program becomes one mesh in world axes, or is refused in plain words."""

import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from lambent_asset.bundle.glb import write_glb
from lambent_asset.given_mesh import glb_file as glb_file_module
from lambent_asset.given_mesh.glb_file import read_glb
from lambent_asset.given_mesh.glb_maps import maps_of
from lambent_core.errors import UsageError
from lambent_relight.asset.draco import glb_with_draco
from lambent_relight.asset.textured_mesh import textured_mesh_from_glb
from scipy.spatial import cKDTree
from support.atlas_box import atlas_box, coloured
from support.given_glb import SQUARE, SQUARE_FACES, SQUARE_UV, GlbWriter, glb_file, y_up

EDITED = Path(__file__).parents[3] / "data" / "edited"


def corners(mesh):
    """Return the corners of all triangles, [face, 3, 3]."""
    return mesh.vertices[mesh.faces]


def test_what_blender_edited_lies_where_it_was_put():
    mesh = read_glb(EDITED / "ball_edited.glb")
    radius = np.linalg.norm(mesh.vertices - [0.0, 0.1, 0.0], axis=1)
    assert 0.49 < radius.min() < radius.max() < 0.55
    assert mesh.vertices[:, 2].max() < 0.4, "the cap is gone"
    halves = corners(mesh).mean(axis=1)[:, 0] > 0.0
    assert halves.sum() > 2.5 * (~halves).sum(), "one half is finer"
    before = textured_mesh_from_glb((EDITED / "ball.glb").read_bytes())
    away, nearest = cKDTree(before.vertices + np.float32([0.0, 0.1, 0.0])).query(mesh.vertices)
    same = away < 1e-5
    assert same.mean() > 0.3
    # Blender keeps the normals that it was given, but along edges of what was deleted or subdivided.
    cosine = (mesh.normals[same] * before.normals[nearest[same]]).sum(axis=1)
    assert np.percentile(cosine, 10) > 0.999
    assert mesh.has_uv == (True,)
    (maps,) = mesh.maps
    assert maps.albedo.shape == maps.packed.shape == maps.normal.shape == (64, 64, 3)
    assert mesh.ignored == ()


def test_several_meshes_are_joined_each_with_its_material():
    mesh = read_glb(EDITED / "ball_joined.glb")
    assert len(mesh.maps) == 2
    for maps, part in zip(mesh.maps, range(2), strict=True):
        places = mesh.vertices[np.unique(mesh.faces[mesh.part_of_face == part])]
        if maps.albedo is None:
            np.testing.assert_allclose(places.min(axis=0), [-0.2, -0.2, 0.55], atol=1e-5)
            np.testing.assert_allclose(places.max(axis=0), [0.2, 0.2, 0.95], atol=1e-5)
            np.testing.assert_allclose(maps.albedo_factor, [0.1, 0.6, 0.2], atol=1e-6)
        else:
            assert places[:, 2].max() < 0.55


def test_nested_and_mirrored_transforms_are_those_of_another_library(tmp_path):
    rng = np.random.default_rng(5)
    scene = trimesh.Scene()
    parent = "world"
    for number in range(3):
        matrix = trimesh.transformations.random_rotation_matrix(rng.random(3))
        matrix[:3, :3] *= rng.uniform(0.3, 1.5) * np.array([1.0, 1.0, -1.0 if number == 1 else 1.0])
        matrix[:3, 3] = rng.normal(size=3)
        part = trimesh.creation.icosphere(subdivisions=1, radius=0.3 + 0.1 * number)
        scene.add_geometry(part, node_name=f"n{number}", parent_node_name=parent, transform=matrix)
        parent = f"n{number}"
    (tmp_path / "nested.glb").write_bytes(scene.export(file_type="glb"))
    mesh = read_glb(tmp_path / "nested.glb")
    expected = scene.to_mesh()
    found = trimesh.Trimesh(y_up(mesh.vertices), mesh.faces, process=False)
    np.testing.assert_allclose(found.bounds, expected.bounds, atol=1e-5)
    np.testing.assert_allclose(found.area, expected.area, rtol=1e-5)
    # A mirrored part would have a negative volume if its triangles were not turned round.
    np.testing.assert_allclose(found.volume, abs(expected.volume), rtol=1e-4)


def test_translation_rotation_and_scale_of_a_node_act_in_that_order(tmp_path):
    half = np.sqrt(0.5)
    node = {"translation": [1.0, 2.0, 3.0], "rotation": [0.0, 0.0, half, half], "scale": [2.0, 1.0, 1.0]}
    mesh = read_glb(glb_file(tmp_path / "a.glb", lambda w: w.mesh(node=node)))
    # x doubles, then turns to y.
    expected = [[1.0 - y, 2.0 + 2.0 * x, 3.0] for x, y, _ in SQUARE.tolist()]
    np.testing.assert_allclose(y_up(mesh.vertices), expected, atol=1e-6)


@pytest.mark.parametrize(("mode", "order"), [(5, [1, 2, 0, 3]), (6, [0, 1, 2, 3])])
def test_strips_and_fans_are_triangles_facing_the_same_way(tmp_path, mode, order):
    plain = read_glb(glb_file(tmp_path / "plain.glb", lambda w: w.mesh()))
    other = read_glb(
        glb_file(tmp_path / "other.glb", lambda w: w.mesh(faces=np.array(order, np.uint16), mode=mode))
    )

    def normals(mesh):
        a, b, c = corners(mesh).transpose(1, 0, 2)
        return np.cross(b - a, c - a)

    assert len(other.faces) == 2
    np.testing.assert_allclose(normals(other), normals(plain), atol=1e-6)


def test_a_mesh_without_indices_is_triangle_after_triangle(tmp_path):
    mesh = read_glb(
        glb_file(tmp_path / "a.glb", lambda w: w.mesh(SQUARE[[0, 1, 2]], None, SQUARE_UV[[0, 1, 2]]))
    )
    np.testing.assert_allclose(y_up(corners(mesh)[0]), SQUARE[[0, 1, 2]], atol=1e-6)


def test_a_packed_mesh_is_unpacked(tmp_path):
    pytest.importorskip("DracoPy", reason="needs the extra `draco`")
    box = atlas_box(16)
    plain = write_glb(box, coloured(box), unit="unknown")
    (tmp_path / "plain.glb").write_bytes(plain)
    (tmp_path / "packed.glb").write_bytes(glb_with_draco(plain))
    one, other = (read_glb(tmp_path / f"{name}.glb") for name in ("plain", "packed"))
    order = [np.lexsort(np.round(corners(mesh).mean(axis=1).T, 3)) for mesh in (one, other)]
    centres = [corners(mesh).mean(axis=1)[rows] for mesh, rows in zip((one, other), order, strict=True)]
    np.testing.assert_allclose(*centres, atol=1e-4)
    places = [mesh.uv[mesh.faces].mean(axis=1)[rows] for mesh, rows in zip((one, other), order, strict=True)]
    np.testing.assert_allclose(*places, atol=1e-4)


def test_a_packed_mesh_without_the_package_says_what_needs_it(tmp_path, monkeypatch):
    def pack(writer: GlbWriter) -> None:
        writer.mesh()
        primitive = writer.document["meshes"][0]["primitives"][0]
        primitive["extensions"] = {
            "KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}
        }

    monkeypatch.setitem(sys.modules, "DracoPy", None)
    with pytest.raises(
        UsageError, match=r"export\.draco_missing.*a mesh that is packed with Draco"
    ) as caught:
        read_glb(glb_file(tmp_path / "packed.glb", pack))
    assert "--draco" not in caught.value.message


def test_our_own_mesh_comes_back_as_it_went(tmp_path):
    box = atlas_box(16)
    (tmp_path / "box.glb").write_bytes(write_glb(box, coloured(box), unit="unknown"))
    mesh = read_glb(tmp_path / "box.glb")
    np.testing.assert_allclose(mesh.vertices, box.vertices, atol=1e-6)
    np.testing.assert_allclose(mesh.normals, box.normals, atol=1e-6)
    np.testing.assert_array_equal(mesh.uv, box.uv)
    np.testing.assert_array_equal(mesh.faces, box.faces)


def test_triangles_without_an_area_are_left_out(tmp_path):
    faces = np.array([[0, 1, 2], [0, 0, 1], [0, 2, 3]], np.uint16)
    assert len(read_glb(glb_file(tmp_path / "a.glb", lambda w: w.mesh(faces=faces))).faces) == 2


def test_what_has_no_counterpart_is_named(tmp_path):
    def light_up(writer: GlbWriter) -> None:
        number = writer.material({}, roughnessFactor=0.5)
        writer.document["materials"][number] |= {"emissiveFactor": [1.0, 0.0, 0.0], "alphaMode": "BLEND"}
        writer.mesh(material=number)

    assert read_glb(glb_file(tmp_path / "a.glb", light_up)).ignored == ("emission", "transparency")


def not_a_number(writer: GlbWriter) -> None:
    vertices = SQUARE.copy()
    vertices[2, 1] = np.nan
    writer.mesh(vertices)


def bad_uv(writer: GlbWriter) -> None:
    uv = SQUARE_UV.copy()
    uv[0, 0] = np.inf
    writer.mesh(uv=uv)


def with_slot(**slot):
    def change(writer: GlbWriter) -> None:
        number = writer.material({"baseColorTexture": np.zeros((2, 2, 3), np.uint8)})
        writer.document["materials"][number]["pbrMetallicRoughness"]["baseColorTexture"] |= slot
        writer.mesh(material=number)

    return change


def outside_picture(writer: GlbWriter) -> None:
    number = writer.material({"baseColorTexture": np.zeros((2, 2, 3), np.uint8)})
    writer.document["images"] = [{"uri": "colour.png"}]
    writer.mesh(material=number)


def looped(writer: GlbWriter) -> None:
    writer.mesh()
    writer.document["nodes"][0]["children"] = [0]


def requires(name):
    def change(writer: GlbWriter) -> None:
        writer.mesh()
        writer.document["extensionsRequired"] = [name]

    return change


REFUSED = {
    "nothing in it": (lambda w: None, "empty", "no triangles"),
    "flat triangles only": (
        lambda w: w.mesh(faces=np.zeros((1, 3), np.uint16)),
        "empty",
        "no triangles with an area",
    ),
    "lines": (lambda w: w.mesh(mode=1), "no_triangles", "lines where triangles"),
    "points": (lambda w: w.mesh(mode=0), "no_triangles", "points where triangles"),
    "a position that is not a number": (not_a_number, "not_finite", "1 vertices whose positions"),
    "texture coordinates that are not numbers": (bad_uv, "not_finite", "texture coordinates"),
    "an armature": (lambda w: w.mesh(node={"skin": 0}), "unsupported", "apply the armature"),
    "shape keys": (lambda w: w.mesh(targets=[{"POSITION": 0}]), "unsupported", "shape keys"),
    "meshopt": (requires("EXT_meshopt_compression"), "unsupported", "EXT_meshopt_compression"),
    "a second set of coordinates": (with_slot(texCoord=1), "unreadable", "second set"),
    "a mapping": (with_slot(extensions={"KHR_texture_transform": {}}), "unreadable", "bake it"),
    "a texture that is not there": (with_slot(index=7), "unreadable", "not a whole GLB"),
    "a picture outside": (outside_picture, "unreadable", "outside the file"),
    "a loop": (looped, "unreadable", "loop"),
    "vertices that are not there": (
        lambda w: w.mesh(faces=np.array([[0, 1, 9]], np.uint16)),
        "unreadable",
        "not there",
    ),
    "fewer coordinates than vertices": (
        lambda w: w.mesh(uv=SQUARE_UV[:3]),
        "unreadable",
        "different numbers",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_taken_over_is_refused(tmp_path, name):
    change, code, words = REFUSED[name]
    path = glb_file(tmp_path / "given.glb", change)
    with pytest.raises(UsageError, match=rf"mesh_file\.{code}: \"given\.glb\" .*{words}") as caught:
        read_glb(path)
    assert ";" in caught.value.message, "it says what to do"


def test_a_file_that_is_cut_short_or_no_glb_is_refused(tmp_path):
    whole = glb_file(tmp_path / "whole.glb", lambda w: w.mesh(faces=SQUARE_FACES)).read_bytes()
    for data in (b"", b"solid cube", whole[: len(whole) // 2], whole[:-8], whole[:20]):
        (tmp_path / "cut.glb").write_bytes(data)
        with pytest.raises(UsageError, match=r"mesh_file\.unreadable"):
            read_glb(tmp_path / "cut.glb")
    with pytest.raises(UsageError, match=r"mesh_file\.unreadable.*cannot be opened"):
        read_glb(tmp_path / "none.glb")


def test_one_mesh_shown_by_many_nodes_is_refused_before_it_is_copied(tmp_path, monkeypatch):
    def change(writer: GlbWriter) -> None:
        writer.mesh(np.tile(SQUARE, (10, 1)), np.concatenate([SQUARE_FACES + 4 * k for k in range(10)] * 3))
        writer.document["nodes"] = [{"mesh": 0}] * 50_000
        writer.document["scenes"][0]["nodes"] = list(range(50_000))

    def never(*arguments):
        raise AssertionError("an array was copied")

    path = glb_file(tmp_path / "many.glb", change)
    monkeypatch.setattr(glb_file_module, "glb_accessor", never)
    with pytest.raises(UsageError, match=r"mesh_file\.too_large.* triangles and .*decimate it below"):
        read_glb(path)


def test_vertices_without_triangles_count_too(tmp_path, monkeypatch):
    monkeypatch.setattr(glb_file_module, "MAX_VERTICES", 7)
    assert len(read_glb(glb_file(tmp_path / "one.glb", lambda w: w.mesh())).faces) == 2
    with pytest.raises(UsageError, match=r"mesh_file\.too_large.* 8 vertices"):
        read_glb(glb_file(tmp_path / "two.glb", lambda w: w.mesh(), lambda w: w.mesh()))


def test_a_material_of_many_parts_is_read_once_and_is_one_part(tmp_path, monkeypatch):
    read = []
    monkeypatch.setattr(glb_file_module, "maps_of", lambda *a, **k: (read.append(a[2]), maps_of(*a, **k))[1])

    def change(writer: GlbWriter) -> None:
        numbers = [
            writer.material({"baseColorTexture": np.full((2, 2, 3), level, np.uint8)}) for level in (0, 255)
        ]
        for step in range(6):
            writer.mesh(SQUARE + np.float32([2.0 * step, 0.0, 0.0]), material=numbers[step % 2])

    mesh = read_glb(glb_file(tmp_path / "a.glb", change))
    assert sorted(read) == [0, 1]
    assert mesh.has_uv == (True, True)
    assert {maps.albedo.max() for maps in mesh.maps} == {0, 255}
    for part, maps in enumerate(mesh.maps):
        assert maps.albedo.dtype == np.uint8
        first = 0 if maps.albedo.max() == 0 else 1
        x = corners(mesh)[mesh.part_of_face == part].mean(axis=1)[:, 0]
        assert set((x // 2.0).astype(int)) == set(range(first, 6, 2))


def test_pictures_are_counted_together(tmp_path, monkeypatch):
    monkeypatch.setattr(glb_file_module, "MAX_PIXELS", 7)

    def pictures(count):
        def change(writer: GlbWriter) -> None:
            for _ in range(count):
                writer.mesh(material=writer.material({"baseColorTexture": np.zeros((2, 2, 3), np.uint8)}))

        return glb_file(tmp_path / f"{count}.glb", change)

    assert len(read_glb(pictures(1)).maps) == 1
    with pytest.raises(UsageError, match=r"mesh_file\.too_large.*pictures of more than 7 pixels"):
        read_glb(pictures(2))


def _changed(whole, length, rng):
    """Return the file with two other digits in its JSON."""
    data = bytearray(whole)
    digits = [place for place in range(20, 20 + length) if chr(whole[place]).isdigit()]
    for place in rng.choice(digits, 2):
        data[place] = ord("0") + rng.integers(0, 10)
    return data


def _ending(path, data):
    """Return what reading a file ends with; every other error fails the test."""
    path.write_bytes(data)
    try:
        mesh = read_glb(path)
    except UsageError as error:
        assert error.code.startswith("mesh_file.")  # noqa: PT017 - most files are refused, and some are read
        return "refused"
    assert np.isfinite(mesh.vertices).all()
    return "read"


@pytest.mark.parametrize("seed", range(4))
def test_changed_digits_never_end_in_anything_but_a_refusal_or_a_mesh(tmp_path, seed):
    whole = bytearray((EDITED / "ball_joined.glb").read_bytes())
    rng = np.random.default_rng(seed)
    length = int.from_bytes(whole[12:16], "little")
    ends = [_ending(tmp_path / "changed.glb", _changed(whole, length, rng)) for _ in range(60)]
    assert 0 < ends.count("refused") < 60
