"""The surface of a bundle, from a file that may come from a stranger."""

import json
import struct

import numpy as np
import pytest
from lambent_relight import BundleError
from lambent_relight.baked.mesh import mesh_from_glb
from support.baked_bundle import glb

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5]], np.float32)


def changed(change) -> bytes:
    """Return the file with another JSON chunk."""
    data = glb(VERTICES, FACES, UV)
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = struct.pack("<II", len(text), 0x4E4F534A) + text + data[20 + length :]
    return struct.pack("<III", 0x46546C67, 2, 12 + len(rest)) + rest


def test_a_mesh_is_read_as_it_was_written():
    mesh = mesh_from_glb(glb(VERTICES, FACES, UV))
    np.testing.assert_array_equal(mesh.vertices, VERTICES)
    np.testing.assert_array_equal(mesh.faces, FACES)
    np.testing.assert_array_equal(mesh.uv, UV)


def test_normals_and_tangents_must_fit():
    def short(document):
        document["accessors"][3]["count"] = 3

    def whole(document):
        document["accessors"][3].update(bufferView=2, componentType=5125, count=2)

    mesh = mesh_from_glb(changed(lambda _: None))
    assert (mesh.normals == [0, 0, 1]).all()
    assert (mesh.tangents == [1, 0, 0, 1]).all()
    for spoil in (short, whole):
        with pytest.raises(BundleError, match="normals or tangents that do not fit"):
            mesh_from_glb(changed(spoil))


def primitive(document):
    return document["meshes"][0]["primitives"][0]


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d["accessors"][0].update(count=10_000_000_000),
        lambda d: d["accessors"][0].update(count=-1),
        lambda d: d["accessors"][4].update(byteOffset=8),
        lambda d: d["bufferViews"][0].update(byteOffset=-4),
        lambda d: d["bufferViews"][1].update(byteStride=0),
        lambda d: d["accessors"][1].update(type="VEC3"),
        lambda d: d["accessors"][2].update(componentType=5126),
        lambda d: d["accessors"][0].update(componentType=5125),
        lambda d: d["accessors"][1].update(count=2),
        lambda d: primitive(d)["attributes"].pop("TEXCOORD_0"),
        lambda d: primitive(d)["attributes"].pop("NORMAL"),
        lambda d: primitive(d)["attributes"].pop("TANGENT"),
        lambda d: primitive(d).update(mode=1),
        lambda d: primitive(d).update(indices=77),
        lambda d: primitive(d)["attributes"].update(POSITION="zero"),
        lambda d: d.update(meshes=[]),
    ],
)
def test_a_mesh_that_lies_is_refused(change):
    with pytest.raises(BundleError, match=r"bundle\.mesh_invalid"):
        mesh_from_glb(changed(change))


def test_damaged_bytes_are_refused():
    data = glb(VERTICES, FACES, UV)
    far = glb(VERTICES, FACES + 3, UV)
    outside = glb(VERTICES, FACES, UV + 0.5)
    wild = glb(np.where(VERTICES > 0, np.nan, VERTICES), FACES, UV)
    for bad in (b"", data[:15], data[:60], b"glTF" + data[4:40], data[:-8], far, outside, wild):
        with pytest.raises(BundleError, match=r"bundle\.mesh_invalid"):
            mesh_from_glb(bad)
