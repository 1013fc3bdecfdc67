"""A folder of masks beside a capture: which mask belongs to which frame, and what is said of the rest."""

import numpy as np
import pytest
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.layouts.mask_folder import attach_masks
from lambent_capture.problems import Problems
from support.captures import save, write_blender, write_tensoir

MASK = np.full((12, 12), 255, dtype=np.uint8)


def attached(folder, masks, names):
    for name in names:
        save(masks / name, MASK)
    problems = Problems()
    manifest = collect_scene(folder, None, problems)
    attach_masks(manifest, folder, masks, problems)
    return {frame.name: frame.mask for frame in manifest.frames}, [f.code for f in problems.findings()]


BLENDER = [f"train/r_{i}" for i in range(5)] + [f"test/r_{i}" for i in range(2)]
TENSOIR = [f"train_{i:03d}" for i in range(5)] + [f"test_{i:03d}" for i in range(2)]


@pytest.mark.parametrize("form", ["{}.png", "{}.jpg", "{}.png.png"])
def test_masks_are_found_by_the_path_of_their_picture(tmp_path, form):
    folder, masks = write_blender(tmp_path / "scene"), tmp_path / "masks"
    found, codes = attached(folder, masks, [form.format(name) for name in BLENDER])
    assert codes == []
    assert found["train_r_3"] == (masks / form.format("train/r_3")).as_posix()


def test_masks_are_found_by_the_name_of_their_frame(tmp_path):
    folder, masks = write_tensoir(tmp_path / "scene"), tmp_path / "masks"
    found, codes = attached(folder, masks, [f"{name}.png" for name in TENSOIR])
    assert codes == []
    assert found["test_001"].endswith("masks/test_001.png")


def test_a_picture_name_that_several_frames_share_names_no_mask(tmp_path):
    folder, masks = write_blender(tmp_path / "scene"), tmp_path / "masks"
    found, codes = attached(folder, masks, [f"r_{i}.png" for i in range(5)])
    # r_0 and r_1 are train and test pictures; r_2 to r_4 are not ambiguous.
    assert [name for name, mask in found.items() if mask] == ["train_r_2", "train_r_3", "train_r_4"]
    assert codes == ["scene.mask_file_missing"]


def test_masks_inside_the_capture_have_relative_paths(tmp_path):
    folder = write_tensoir(tmp_path / "scene")
    found, _ = attached(folder, folder / "cut", [f"{name}.png" for name in TENSOIR])
    assert found["train_000"] == "cut/train_000.png"


def test_missing_masks_are_one_error_that_counts_them(tmp_path):
    folder, masks = write_tensoir(tmp_path / "scene"), tmp_path / "masks"
    save(masks / "train_000.png", MASK)
    problems = Problems()
    attach_masks(collect_scene(folder, None, problems), folder, masks, problems)
    (finding,) = problems.findings()
    assert not problems.usable
    assert (finding.code, finding.subject) == ("scene.mask_file_missing", "test_000")
    assert "6 of 7 frames" in finding.message


def test_a_mask_of_no_frame_is_noted(tmp_path):
    folder, masks = write_tensoir(tmp_path / "scene"), tmp_path / "masks"
    _, codes = attached(folder, masks, [f"{name}.png" for name in [*TENSOIR, "train_099"]])
    assert codes == ["scene.mask_unused"]


def test_a_folder_that_does_not_exist_is_an_error(tmp_path):
    folder = write_tensoir(tmp_path / "scene")
    _, codes = attached(folder, tmp_path / "nowhere", [])
    assert codes == ["scene.mask_folder_missing"]
