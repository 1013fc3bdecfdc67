"""Code points in the boxes of HEIC and AVIF."""

import struct

import numpy as np
import pytest
from lambent_capture.pictures.heif_boxes import nclx_of
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.pictures.pictures import read_picture
from PIL import Image
from support.photographs import heif


def box(kind, *content):
    data = b"".join(content)
    return struct.pack(">I", 8 + len(data)) + kind + data


def nclx(primaries, transfer):
    return box(b"colr", b"nclx", struct.pack(">HHHB", primaries, transfer, 6, 0x80))


def pictures(associations, *described, primary=1):
    """Return the start of a file whose item `n` has the properties numbered `associations[n]`."""
    entries = b"".join(
        struct.pack(">HB", item, len(numbers)) + bytes(numbers) for item, numbers in associations.items()
    )
    ipma = box(b"ipma", bytes(4), struct.pack(">I", len(associations)), entries)
    meta = box(
        b"meta",
        bytes(4),
        box(b"pitm", bytes(4), struct.pack(">H", primary)),
        box(b"iprp", box(b"ipco", *described), ipma),
    )
    return box(b"ftyp", b"avif", bytes(4)) + meta


def test_the_code_points_of_the_primary_picture_count(tmp_path):
    data = pictures({1: [2], 2: [1]}, nclx(1, 13), nclx(12, 13))
    (tmp_path / "a.avif").write_bytes(data)
    assert nclx_of(tmp_path / "a.avif") == (12, 13)
    (tmp_path / "a.avif").write_bytes(pictures({1: [2], 2: [1]}, nclx(1, 13), nclx(12, 13), primary=2))
    assert nclx_of(tmp_path / "a.avif") == (1, 13)


def test_a_file_without_them_states_nothing(tmp_path):
    for data in (b"", b"\0\0", pictures({1: []}), box(b"ftyp", b"avif"), b"\0\0\0\1meta" + b"\xff" * 40):
        (tmp_path / "a.avif").write_bytes(data)
        assert nclx_of(tmp_path / "a.avif") is None


@pytest.mark.parametrize(("primaries", "transfer"), [(12, 13), (9, 16), (9, 18)])
def test_a_heic_is_read_by_its_code_points(tmp_path, primaries, transfer):
    heif()
    import pillow_heif

    levels = np.full((64, 64, 3), (200, 120, 60), dtype=np.uint8)
    image = pillow_heif.from_pillow(Image.fromarray(levels))
    image.save(
        tmp_path / "a.heic",
        quality=100,
        save_nclx_profile=True,
        color_primaries=primaries,
        transfer_characteristics=transfer,
    )
    assert nclx_of(tmp_path / "a.heic") == (primaries, transfer)
    if transfer != 13:
        with pytest.raises(PictureError, match="high dynamic range"):
            read_picture(tmp_path / "a.heic")
        return
    encoded = np.array([200, 120, 60]) / 255.0
    light = ((encoded + 0.055) / 1.055) ** 2.4
    matrix = np.array([[1.2249, -0.2247, 0.0], [-0.0420, 1.0419, 0.0], [-0.0197, -0.0786, 1.0979]])
    np.testing.assert_allclose(read_picture(tmp_path / "a.heic").linear()[32, 32], matrix @ light, atol=0.02)
