"""Binary glTF files, read back by another library."""

import io
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from lambent_worker.bundle.glb import check_glb, write_glb
from lambent_worker.bundle.mesh import Mesh
from lambent_worker.errors import WorkerError

VERTICES = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, 5.0]], np.float32)
ALBEDO = np.array([[0.5, 0.25, 0.02], [1.0, 0.0, 0.0], [0.0, 1.2, 0.0], [0.0, 0.0, 1.0]], np.float32)


@pytest.fixture(scope="module")
def mesh():
    return Mesh(
        vertices=VERTICES,
        faces=np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.uint32),
        normals=VERTICES * 2.0 + 0.1,
        albedo=ALBEDO,
        perceptual_roughness=np.array([[0.2], [0.4], [0.6], [0.8]], np.float32),
        metalness=np.array([[0.0], [0.0], [0.0], [1.0]], np.float32),
    )


@pytest.fixture(scope="module")
def data(mesh):
    return write_glb(mesh)


def document(data: bytes) -> dict:
    length = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + length])


def test_the_worlds_z_axis_is_up_in_the_file(data):
    scene = trimesh.load_scene(io.BytesIO(data), file_type="glb")
    world = scene.to_mesh().vertices
    assert np.allclose(world[3], [0.0, 5.0, 0.0], atol=1e-6)
    assert np.allclose(world[2], [0.0, 0.0, -3.0], atol=1e-6)


def test_vertices_faces_and_linear_colours_survive(data):
    (mesh,) = trimesh.load_scene(io.BytesIO(data), file_type="glb").geometry.values()
    assert np.allclose(mesh.vertices, VERTICES)
    assert mesh.faces.tolist() == [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    colours = np.asarray(mesh.visual.vertex_attributes["color"], np.float64)
    assert np.allclose(colours[:, :3] / 65535.0, ALBEDO.clip(0.0, 1.0), atol=1e-5)
    assert np.allclose(np.linalg.norm(mesh.vertex_normals, axis=1), 1.0, atol=1e-5)


def test_the_material_has_the_mean_roughness_and_metalness(data):
    material = document(data)["materials"][0]["pbrMetallicRoughness"]
    assert material == {"metallicFactor": 0.25, "roughnessFactor": 0.5}


def test_chunks_are_aligned_and_lengths_add_up(data):
    magic, version, total = struct.unpack_from("<4sII", data)
    assert (magic, version, total) == (b"glTF", 2, len(data))
    length = struct.unpack_from("<I", data, 12)[0]
    assert length % 4 == 0
    rest = struct.unpack_from("<I", data, 20 + length)[0]
    assert 20 + length + 8 + rest == len(data)
    assert all(view["byteOffset"] % 4 == 0 for view in document(data)["bufferViews"])


def test_the_check_accepts_the_file_and_refuses_that_of_another_mesh(data, mesh):
    check_glb(data, mesh)
    with pytest.raises(WorkerError, match=r"export\.mesh"):
        check_glb(data, replace(mesh, vertices=mesh.vertices + np.float32(0.1)))
    with pytest.raises(WorkerError, match=r"export\.mesh"):
        check_glb(data, replace(mesh, faces=mesh.faces[:2]))
