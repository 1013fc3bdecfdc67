"""Photographs are found with their masks, and what cannot be used is named."""

import numpy as np
import pytest
from lambent_capture.pictures.picture_error import PictureError
from lambent_capture.poses.photographs import covered_pixels, find_photographs
from lambent_capture.problems import Problems
from PIL import Image
from support.captures import save


def opaque(side=8):
    return np.full((side, side, 3), 90, dtype=np.uint8)


def half_covered():
    pixels = np.full((8, 8, 4), 255, dtype=np.uint8)
    pixels[:, :4, 3] = 0
    return pixels


def found(folder, masks=None):
    """Return photographs, and what was noted: codes and messages."""
    problems = Problems()
    photographs = find_photographs(folder, masks, problems)
    return photographs, {finding.code: finding.message for finding in problems.findings()}


@pytest.mark.parametrize("suffix", [".jpg", ".png", ".webp"])
def test_opaque_photographs_are_no_masks_of_their_own(tmp_path, suffix):
    for number in range(3):
        save(tmp_path / f"{number}{suffix}", opaque())
    photographs, said = found(tmp_path)
    assert not said
    assert not photographs.cut_out
    assert not photographs.masked
    assert photographs.names == tuple(f"{number}{suffix}" for number in range(3))


def test_pictures_with_an_alpha_that_hides_nothing_are_not_cut_out(tmp_path):
    for number in range(3):
        save(tmp_path / f"{number}.png", np.full((8, 8, 4), 255, dtype=np.uint8))
    photographs, _ = found(tmp_path)
    assert not photographs.masked


def test_alpha_of_the_photographs_is_their_mask(tmp_path):
    for number in range(3):
        save(tmp_path / f"{number}.png", half_covered())
    photographs, _ = found(tmp_path)
    assert photographs.cut_out
    assert np.array_equal(covered_pixels(photographs, "1.png"), half_covered()[..., 3] > 0)
    save(tmp_path / "1.png", opaque())
    photographs, said = found(tmp_path)
    assert photographs is None
    assert (
        "2 of 3 photographs have a transparent background, but not 1.png" in said["scene.mask_file_missing"]
    )


def test_a_photograph_that_cannot_be_read_does_not_shift_the_names(tmp_path):
    for number in (1, 3):
        save(tmp_path / f"{number}.png", half_covered())
    save(tmp_path / "2.png", opaque())
    (tmp_path / "0.png").write_bytes(b"no picture")
    photographs, said = found(tmp_path)
    assert photographs is None
    assert (
        "2 of 3 photographs have a transparent background, but not 2.png" in said["scene.mask_file_missing"]
    )


def test_masks_are_found_in_a_folder_of_their_own(tmp_path):
    for name in ("a.png", "b.webp", "sub/c.png"):
        save(tmp_path / "in" / name, opaque())
        mask = np.zeros((8, 8), dtype=np.uint8)
        mask[2:] = 255
        save(tmp_path / "cut" / f"{name.rsplit('/')[-1]}", mask)
    photographs, said = found(tmp_path / "in", tmp_path / "cut")
    assert not said
    assert photographs.names == ("a.png", "b.webp", "sub/c.png")
    assert set(photographs.masks) == set(photographs.names)
    assert covered_pixels(photographs, "sub/c.png").sum() == 48


def test_masks_lie_beside_images(tmp_path):
    for number in range(3):
        save(tmp_path / "images" / f"{number}.jpg", opaque())
        save(tmp_path / "masks" / f"{number}.png", np.full((8, 8), 255, dtype=np.uint8))
    photographs, _ = found(tmp_path)
    assert photographs.folder == tmp_path / "images"
    assert len(photographs.masks) == 3


def test_files_that_are_no_pictures_are_left_out_while_most_are(tmp_path):
    for number in range(4):
        save(tmp_path / f"{number}.png", opaque())
    (tmp_path / "5.jpg").write_text("no picture")
    (tmp_path / "._0.png").write_text("shadow")
    photographs, said = found(tmp_path)
    assert len(photographs.names) == 4
    assert "5.jpg" in said["scene.image_not_a_picture"]
    for number in range(6, 12):
        (tmp_path / f"{number}.jpg").write_text("no picture")
    photographs, _ = found(tmp_path)
    assert photographs is None


def test_too_few_photographs_are_refused(tmp_path):
    save(tmp_path / "1.png", opaque())
    for folder in (tmp_path, tmp_path / "nowhere"):
        photographs, said = found(folder)
        assert photographs is None
        assert "3 are needed at least" in said["scene.too_few_images"]


def test_each_fault_of_a_mask_is_named(tmp_path):
    for number in range(3):
        save(tmp_path / "in" / f"{number}.png", opaque())
        save(tmp_path / "cut" / f"{number}.png", np.full((8, 8), 255, dtype=np.uint8))
    save(tmp_path / "cut" / "1.png", np.zeros((8, 8), dtype=np.uint8))
    Image.new("L", (8, 4), 255).save(tmp_path / "cut" / "2.png")
    photographs, _ = found(tmp_path / "in", tmp_path / "cut")
    assert covered_pixels(photographs, "0.png").all()
    for name, code in (("1.png", "scene.mask_empty"), ("2.png", "scene.mask_size")):
        with pytest.raises(PictureError) as caught:
            covered_pixels(photographs, name)
        assert caught.value.code == code
    (tmp_path / "cut" / "0.png").unlink()
    photographs, said = found(tmp_path / "in", tmp_path / "cut")
    assert photographs is None
    assert "scene.mask_file_missing" in said
