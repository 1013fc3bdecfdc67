"""Cryptomatte: published hashes, and ids that are ordinary floats."""

import numpy as np
import pytest
from lambent_relight.cryptomatte import (
    CHANNELS,
    cryptomatte_attributes,
    cryptomatte_channels,
    id_bits,
    murmur3,
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [("", 0), ("hello", 0x248BFA47), ("The quick brown fox jumps over the lazy dog", 0x2E4FF723)],
)
def test_the_hash_is_murmur3(text, expected):
    assert murmur3(text.encode()) == expected


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # From the tests of the specification's own implementation (cryptomatte_utilities).
        ("hello", 6.0705627102400005616e-17),
        ("cube", -4.08461912519e15),
        ("sphere", 2.79018604383e15),
        ("plane", 3.66557617593e-11),
    ],
)
def test_ids_are_those_of_the_specifications_implementation(name, expected):
    assert np.uint32(id_bits(name)).view(np.float32) == pytest.approx(expected, rel=1e-6)


def test_every_id_is_an_ordinary_float():
    bits = np.array([id_bits(f"object {number}") for number in range(3000)] + [id_bits("")], np.uint32)
    ids = np.abs(bits.view(np.float32))
    assert np.isfinite(ids).all()
    assert ids.min() >= np.finfo(np.float32).tiny


def test_names_beyond_ascii_are_hashed_as_utf8_and_written_as_they_are():
    manifest = cryptomatte_attributes("Krug \u58f6")["cryptomatte/3ae39a5/manifest"]
    assert manifest == f'{{"Krug \u58f6":"{id_bits("Krug " + chr(0x58F6)):08x}"}}'


def test_pixels_without_the_object_have_no_id():
    planes = cryptomatte_channels("vase", np.array([[0.0, 0.25, 1.0]]))
    assert list(planes) == list(CHANNELS)
    np.testing.assert_array_equal(planes["CryptoObject00.R"] != 0.0, [[False, True, True]])
    np.testing.assert_array_equal(planes["CryptoObject00.G"], np.float32([[0.0, 0.25, 1.0]]))
