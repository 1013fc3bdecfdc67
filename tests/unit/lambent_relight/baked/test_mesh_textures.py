"""The textures of a mesh file that may come from a stranger."""

import struct
import zlib

import numpy as np
import pytest
from lambent_asset.bundle.glb import write_glb
from lambent_relight import BundleError
from lambent_relight.baked.mesh import glb_chunks, mesh_from_glb
from lambent_relight.baked.mesh_textures import texture_files
from support.atlas_box import atlas_box, coloured
from support.spoilt_glb import spoilt_glb, with_document

BOX = atlas_box(32)
DATA = write_glb(BOX, coloured(BOX), unit="unknown")


def ending(read, data):
    """Return what reading a file ends with; every other error fails the test."""
    try:
        read(data)
    except BundleError as error:
        assert error.code == "bundle.mesh_invalid"  # noqa: PT017 - some files are refused, and some are read
        return "refused"
    return "read"


@pytest.mark.parametrize("read", [texture_files, mesh_from_glb])
def test_no_value_in_the_file_ends_in_anything_but_a_refusal_or_pictures(read):
    rng = np.random.default_rng(7)
    ends = [ending(read, spoilt_glb(DATA, rng)) for _ in range(400)]
    assert 0 < ends.count("refused") < 400


@pytest.mark.parametrize("views", [["a"], {"0": 1}, None, 5])
def test_views_of_another_type_are_refused(views):
    document = glb_chunks(DATA)[0]
    document["bufferViews"] = views
    assert ending(texture_files, with_document(DATA, document)) == "refused"


@pytest.mark.parametrize("size", [(8193, 1), (1, 8193), (65535, 65535), (2**31 - 1, 2**31 - 1)])
def test_a_picture_beyond_the_largest_atlas_is_refused_before_it_is_decoded(size):
    document, payload = glb_chunks(DATA)
    view = document["bufferViews"][document["images"][0]["bufferView"]]
    header = struct.pack(">II", *size) + bytes([8, 2, 0, 0, 0])
    chunk = struct.pack(">I", 13) + b"IHDR" + header + struct.pack(">I", zlib.crc32(b"IHDR" + header))
    start = DATA.index(payload) + view["byteOffset"] + 8
    spoilt = DATA[:start] + chunk + DATA[start + len(chunk) :]
    with pytest.raises(BundleError, match=f"{size[0]} x {size[1]} texels, more than 8192"):
        texture_files(spoilt)
