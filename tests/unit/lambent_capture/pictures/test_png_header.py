"""The chunks of a PNG before its pixels are understood."""

import numpy as np
import pytest
from lambent_capture.pictures.pictures import has_alpha, read_picture
from lambent_capture.pictures.png_header import png_header
from strangers.profiles import chunk, png

COLOURS = np.array([[[10, 20, 30], [40, 50, 60]]], dtype=np.uint16)


def test_chunks_are_read_with_their_numbers(tmp_path):
    chunks = (
        chunk(b"gAMA", (45455).to_bytes(4, "big")),
        chunk(b"sRGB", b"\0"),
        chunk(b"cICP", bytes([12, 13, 0, 1])),
        chunk(b"tRNS", b"\0\x0a\0\x14\0\x1e"),
    )
    (tmp_path / "a.png").write_bytes(png(COLOURS, *chunks, bits=8))
    header = png_header(tmp_path / "a.png")
    assert (header.bit_depth, header.colour_type, header.key) == (8, 2, (10, 20, 30))
    assert (header.gamma, header.is_srgb, header.code_points) == (0.45455, True, (12, 13, 0, 1))
    assert header.chromaticities is None


def test_a_chunk_of_a_wrong_length_says_nothing(tmp_path):
    chunks = (chunk(b"gAMA", b"\1"), chunk(b"cHRM", b"\1" * 31), chunk(b"tRNS", b"\0"))
    (tmp_path / "a.png").write_bytes(png(COLOURS, *chunks, bits=8))
    header = png_header(tmp_path / "a.png")
    assert (header.gamma, header.chromaticities, header.key) == (0.0, None, ())


def test_a_file_without_a_header_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(ValueError, match="header"):
        png_header(tmp_path / "a.png")


@pytest.mark.parametrize("depth", [8, 16])
def test_the_key_of_colours_is_transparent(tmp_path, depth):
    key = chunk(b"tRNS", b"\0\x0a\0\x14\0\x1e")
    (tmp_path / "a.png").write_bytes(png(COLOURS, key, bits=depth))
    assert has_alpha(tmp_path / "a.png")
    found = read_picture(tmp_path / "a.png")
    np.testing.assert_array_equal(found.coverage(), [[0.0, 1.0]])
    np.testing.assert_array_equal(found.levels, COLOURS)


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_the_key_of_greys_is_transparent_at_every_depth(tmp_path, depth):
    levels = np.array([[[1], [0], [1], [0]]], dtype=np.uint16)
    (tmp_path / "a.png").write_bytes(png(levels, chunk(b"tRNS", b"\0\1"), bits=depth))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png").coverage(), [[0.0, 1.0, 0.0, 1.0]])
