"""Binary glTF files, read back by another library."""

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from lambent_asset.bundle.glb import check_glb, write_glb
from lambent_core.errors import WorkerError
from support.atlas_box import SIZES, atlas_box, coloured


@pytest.fixture(scope="module")
def surface():
    return atlas_box()


@pytest.fixture(scope="module")
def data(surface):
    return write_glb(surface, coloured(surface), unit="unknown")


def document(data: bytes) -> dict:
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length])


def material(data: bytes):
    (mesh,) = trimesh.load_scene(io.BytesIO(data), file_type="glb").geometry.values()
    return mesh.visual.material


def test_the_worlds_z_axis_is_up_in_the_file(data):
    world = trimesh.load_scene(io.BytesIO(data), file_type="glb").to_mesh()
    assert np.allclose(world.extents, SIZES[[0, 2, 1]], atol=1e-6)


def test_the_surface_survives_with_its_normals(data, surface):
    (mesh,) = trimesh.load_scene(io.BytesIO(data), file_type="glb").geometry.values()
    assert np.allclose(mesh.vertices, surface.vertices)
    assert np.array_equal(mesh.faces, surface.faces)
    assert np.allclose(mesh.vertex_normals, surface.normals, atol=1e-6)


def test_base_colours_are_srgb_and_other_textures_linear(data):
    found = material(data)
    colour = np.asarray(found.baseColorTexture.convert("RGB"))
    # Linear 0.5, 0.2 and 0 on the top face.
    assert [188, 124, 0] in colour.reshape(-1, 3).tolist()
    packed = np.unique(np.asarray(found.metallicRoughnessTexture.convert("RGB")).reshape(-1, 3), axis=0)
    assert packed.tolist() == [[191, 102, 255]]


def test_roughness_is_green_and_metalness_blue_and_both_factors_are_one(data):
    described = document(data)["materials"][0]
    assert described["pbrMetallicRoughness"]["metallicFactor"] == 1.0
    assert described["pbrMetallicRoughness"]["roughnessFactor"] == 1.0
    packed = described["pbrMetallicRoughness"]["metallicRoughnessTexture"]["index"]
    assert described["occlusionTexture"]["index"] == packed
    assert described["normalTexture"]["index"] not in (packed, 0)


def test_unit_and_axes_are_stated(data):
    assert document(data)["asset"]["extras"] == {
        "unit": "unknown",
        "up_axis": "y",
        "mesh_up_axis": "z",
        "colour": "linear-rec709",
    }


def test_chunks_are_aligned_and_lengths_add_up(data):
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    length = struct.unpack_from("<I", data, 12)[0]
    assert length % 4 == 0
    rest = struct.unpack_from("<I", data, 20 + length)[0]
    assert 20 + length + 8 + rest == len(data)
    assert all(view["byteOffset"] % 4 == 0 for view in document(data)["bufferViews"])


def test_many_vertices_need_wide_indices(surface):
    def component(count: int) -> int:
        more = np.resize(np.arange(len(surface.vertices)), count)
        wide = replace(
            surface,
            vertices=surface.vertices[more],
            normals=surface.normals[more],
            uv=surface.uv[more],
        )
        described = document(write_glb(wide, coloured(surface), unit="unknown"))
        return described["accessors"][described["meshes"][0]["primitives"][0]["indices"]]["componentType"]

    assert component(65534) == 5123
    assert component(65535) == 5125


def test_the_check_refuses_a_file_of_another_surface(data, surface):
    check_glb(data, surface)
    for changed in (
        replace(surface, vertices=surface.vertices + np.float32(0.1)),
        replace(surface, faces=surface.faces[:2]),
        replace(surface, faces=surface.faces[:, [0, 2, 1]]),
        replace(surface, uv=surface.uv * np.float32([1.0, -1.0]) + np.float32([0.0, 1.0])),
    ):
        with pytest.raises(WorkerError, match=r"export\.mesh"):
            check_glb(data, changed)
