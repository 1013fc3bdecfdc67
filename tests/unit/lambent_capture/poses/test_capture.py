"""Photographs of a solved capture are the pictures that its cameras were solved for."""

import numpy as np
import pytest
from lambent_capture.pictures.exif import exif_facts
from lambent_capture.pictures.pictures import read_picture
from lambent_capture.poses.capture import _copy
from PIL import Image

LEVELS = np.random.default_rng(4).integers(0, 255, (12, 16, 3), dtype=np.uint8)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".webp", ".avif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_copy_shows_what_was_read_to_programs_that_ignore_exif(tmp_path, suffix, orientation):
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = {"quality": 100} if suffix in (".jpg", ".avif") else {}
    options |= {"lossless": True} if suffix == ".webp" else {}
    given, copy = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    Image.fromarray(LEVELS.repeat(8, 0).repeat(8, 1)).save(given, exif=exif, **options)
    _copy(given, copy)
    seen, copied = read_picture(given).levels.astype(int), read_picture(copy).levels.astype(int)
    assert not exif_facts(copy).is_mirrored
    # A mirror image of these colours differs by 85 levels; JPEG and AVIF blur chroma.
    assert np.abs(seen - copied).mean() < (8.0 if suffix in (".jpg", ".avif") else 0.5)
    if not exif_facts(given).is_mirrored:
        assert copy.read_bytes() == given.read_bytes()
