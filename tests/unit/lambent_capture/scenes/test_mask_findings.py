"""The check's findings about masks that are written unusually, and of photographs stored as mirror images."""

import numpy as np
from lambent_capture.loading.inspect import inspect_files
from PIL import Image
from support.captures import read_transforms, save, write_blender, write_transforms
from support.findings import codes, subject_of, warnings_of


def with_masks(folder, *levels):
    """Write a capture whose frames have masks: a pair (background, object) of levels for each."""
    write_blender(folder)
    side = np.asarray(Image.open(folder / "train" / "r_0.png")).shape[0]
    disc = np.hypot(*(np.mgrid[:side, :side] - side / 2.0)) < side / 4.0
    for number, (background, thing) in enumerate(levels):
        save(folder / "cut" / f"train_r_{number}.png", np.where(disc, thing, background).astype(np.uint8))
    transforms = read_transforms(folder)
    transforms["frames"] = transforms["frames"][: len(levels)]
    write_transforms(folder, "train", transforms)
    (folder / "transforms_test.json").unlink()
    return inspect_files(folder, masks=folder / "cut").report


def test_masks_of_0_and_1_are_as_good_as_any(tmp_path):
    assert with_masks(tmp_path, *[(0, 1)] * 4).usable


def test_masks_that_are_all_inverted_are_taken_as_such_and_said(tmp_path):
    report = with_masks(tmp_path, *[(255, 0)] * 4)
    assert report.usable
    assert "scene.mask_inverted" in warnings_of(report)


def test_masks_of_two_minds_are_refused_with_the_fewer_ones(tmp_path):
    report = with_masks(tmp_path, (0, 255), (0, 255), (255, 0), (0, 255))
    assert codes(report) == ["scene.mask_inverted"]
    assert subject_of(report, "scene.mask_inverted") == "cut/train_r_2.png"
    report = with_masks(tmp_path, (0, 255), (0, 1), (0, 255), (0, 255))
    assert codes(report) == ["scene.mask_levels"]
    assert subject_of(report, "scene.mask_levels") == "cut/train_r_1.png"


def test_mirror_images_beside_given_cameras_are_refused(tmp_path):
    write_blender(tmp_path)
    exif = Image.Exif()
    exif[0x0112] = 2
    image = Image.open(tmp_path / "train" / "r_1.png")
    image.load()
    image.save(tmp_path / "train" / "r_1.png", exif=exif)
    report = inspect_files(tmp_path).report
    assert codes(report) == ["scene.mirrored"]
    assert subject_of(report, "scene.mirrored") == "train/r_1.png"
