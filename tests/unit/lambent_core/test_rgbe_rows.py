"""Lines of Radiance pictures: coded, flat and repeated, mixed in any way, and told from each other."""

import numpy as np
import pytest
from lambent_core.rgbe_rows import DamagedLinesError, decode_lines
from support.environment_layouts import coded, like_coded, repeated

WRITERS = {"coded": coded, "flat": np.ndarray.tobytes, "repeated": repeated}


def random_pixels(lines, length, seed=0):
    pixels = np.random.default_rng(seed).integers(2, 200, (lines, length, 4)).astype(np.uint8)
    pixels[:, length // 3 : length // 2] = pixels[:, length // 3][:, None]
    return pixels


def decoded(data, lines, length):
    return decode_lines(memoryview(data), lines, length)


@pytest.mark.parametrize("order", [("coded", "flat"), ("flat", "coded"), ("repeated", "coded", "flat")])
@pytest.mark.parametrize("length", [8, 31, 300])
def test_lines_of_different_kinds_follow_each_other(order, length):
    pixels = random_pixels(7, length)
    data = b"".join(WRITERS[order[at % len(order)]](line) for at, line in enumerate(pixels))
    np.testing.assert_array_equal(decoded(data, 7, length), pixels)


def test_flat_lines_that_begin_like_coded_ones_are_flat():
    for pixels in (like_coded(), np.full((3, 384, 4), (2, 2, 1, 128), np.uint8)):
        np.testing.assert_array_equal(decoded(pixels.tobytes(), len(pixels), 384), pixels)


def test_a_pixel_that_begins_like_a_coded_line_of_another_length_is_a_pixel():
    pixels = random_pixels(4, 16)
    pixels[0, 0] = (2, 2, 1, 128)
    np.testing.assert_array_equal(decoded(pixels.tobytes(), 4, 16), pixels)


def test_repeats_may_run_on_into_the_next_line_as_old_writers_let_them():
    data = bytes([10, 20, 30, 130, 1, 1, 1, 19])
    np.testing.assert_array_equal(decoded(data, 2, 10), np.full((2, 10, 4), (10, 20, 30, 130)))


def test_further_digits_of_a_count_belong_to_its_line():
    pixels = np.full((2, 514, 4), (9, 8, 7, 128), np.uint8)
    line = bytes([9, 8, 7, 128, 1, 1, 1, 1, 1, 1, 1, 2])
    np.testing.assert_array_equal(decoded(2 * line, 2, 514), pixels)


@pytest.mark.parametrize("kind", WRITERS)
def test_cut_lines_are_damaged(kind):
    data = b"".join(WRITERS[kind](line) for line in random_pixels(4, 40))
    for cut in (1, 5, len(data) // 2, len(data)):
        with pytest.raises(DamagedLinesError):
            decoded(data[:-cut], 4, 40)


def test_damage_in_coded_lines_is_not_taken_for_flat_pixels():
    # Noise becomes longer by coding: there are enough bytes for a flat picture.
    pixels = np.random.default_rng(0).integers(0, 256, (4, 40, 4)).astype(np.uint8)
    data = bytearray(b"".join(coded(line) for line in pixels))
    assert len(data) > pixels.nbytes
    data[4] = 0
    with pytest.raises(DamagedLinesError, match="row 0"):
        decoded(bytes(data), 4, 40)


def test_a_repeat_without_a_pixel_is_damaged():
    with pytest.raises(DamagedLinesError):
        decoded(b"\1\1\1\7" * 9, 4, 8)
