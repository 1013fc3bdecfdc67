"""Masks next to photographs are used, wherever people put them, or a finding says why not."""

import numpy as np
import pytest
from lambent_capture.layouts.detect import collect_scene
from lambent_capture.layouts.mask_search import mask_places, masks_of, photographs_among
from lambent_capture.layouts.picture_files import photographs_in
from lambent_capture.problems import Problems
from support.captures import save, write_blender
from support.layouts import ColmapTextFolder, NerfstudioFolder

STEMS = ("IMG_0", "IMG_1", "IMG_2", "IMG_3")
PLACES = {
    "masks": ("{}.jpg", "masks/{}.png"),
    "mask": ("{}.jpg", "mask/{}.png"),
    "two folders": ("image/{}.jpg", "mask/{}.png"),
    "as COLMAP": ("images/{}.jpg", "masks/{}.jpg.png"),
    "named after the folder": ("images/{}.jpg", "images_masks/{}.png"),
    "twice": ("rgb/{}.jpg", "masks/{}_mask.png"),
    "segmentation": ("images/{}.jpg", "segmentation/{}.png"),
    "object_masks": ("{}.jpg", "object_masks/{}.png"),
    "below": ("images/{}.jpg", "images/masks/{}.png"),
    "with folders": ("images/a/{}.jpg", "masks/a/{}.png"),
    "capitals": ("images/{}.JPG", "Masks/{}.PNG"),
    "underscore": ("{}.jpg", "{}_mask.png"),
    "dash": ("{}.jpg", "{}-mask.png"),
    "dot": ("images/{}.jpg", "images/{}.mask.png"),
    "behind the suffix": ("{}.jpg", "{}.jpg.mask.png"),
    "in front": ("{}.jpg", "mask_{}.png"),
    "segmentation beside": ("{}.jpg", "{}_segmentation.png"),
}


def write(folder, photograph, mask, count=4, size=(12, 16)):
    for number, stem in enumerate(STEMS):
        save(folder / photograph.format(stem), np.full((12, 16, 3), 40 * number, dtype=np.uint8))
        if number < count:
            save(folder / mask.format(stem), np.full(size, 255, dtype=np.uint8))
    return folder


@pytest.mark.parametrize(("photograph", "mask"), PLACES.values(), ids=PLACES.keys())
def test_masks_in_usual_places_belong_to_the_photographs_beside_them(tmp_path, photograph, mask):
    problems = Problems()
    manifest = collect_scene(write(tmp_path, photograph, mask), None, problems)
    assert not problems.findings()
    pairs = {frame.images[0].path: frame.mask for frame in manifest.frames}
    assert pairs == {photograph.format(stem): mask.format(stem) for stem in STEMS}


@pytest.mark.parametrize(("photograph", "mask"), PLACES.values(), ids=PLACES.keys())
def test_masks_that_some_photographs_lack_are_not_used_and_named(tmp_path, photograph, mask):
    problems = Problems()
    manifest = collect_scene(write(tmp_path, photograph, mask, count=3), None, problems)
    assert [each.code for each in problems.findings()] == ["scene.mask_unused"]
    assert "IMG_3" in problems.findings()[0].message
    assert [frame.images[0].path for frame in manifest.frames] == [photograph.format(each) for each in STEMS]
    assert not any(frame.mask for frame in manifest.frames)


def test_masks_of_another_size_are_not_used_and_named(tmp_path):
    problems = Problems()
    manifest = collect_scene(write(tmp_path, "{}.jpg", "mask/{}.png", size=(6, 8)), None, problems)
    assert [each.code for each in problems.findings()] == ["scene.mask_unused"]
    assert "8 x 6" in problems.findings()[0].message
    assert not any(frame.mask for frame in manifest.frames)


@pytest.mark.parametrize("place", ["masks/{}.png", "mask/{}.png", "segmentations/{}.png"])
def test_masks_beside_photographs_with_cameras_are_used(tmp_path, place):
    for kind in (NerfstudioFolder, ColmapTextFolder):
        capture = kind(tmp_path / kind.__name__)
        before = collect_scene(capture.folder, None, Problems())
        capture.mask(0).parent.rename(capture.folder / "kept")
        for index in range(16):
            kept = capture.folder / "kept" / capture.mask(index).name
            target = capture.folder / place.format(capture.picture(index).stem)
            target.parent.mkdir(exist_ok=True)
            kept.rename(target)
        if kind is NerfstudioFolder:
            capture.write_cameras([{**each, "mask_path": None} for each in capture.entries()])
        problems = Problems()
        manifest = collect_scene(capture.folder, None, problems)
        assert not problems.findings()
        assert [frame.mask for frame in manifest.frames] == [
            place.format(capture.picture(index).stem) for index in range(16)
        ]
        assert len(before.frames) == 16


def test_masks_beside_photographs_of_blender_are_used(tmp_path):
    folder = write_blender(tmp_path)
    for path in list(folder.glob("t*/*.png")):
        save(path.with_name(f"{path.stem}_mask.png"), np.full((12, 12), 255, dtype=np.uint8))
    problems = Problems()
    manifest = collect_scene(folder, None, problems)
    assert not problems.findings()
    assert manifest.frames[0].mask == "train/r_0_mask.png"


def test_photographs_that_are_only_called_like_masks_are_photographs(tmp_path):
    names = ["carnival_mask.jpg", "carnival mask 2.jpg", "mask_shop.jpg", "gas_mask/1.jpg", "gas_mask/2.jpg"]
    assert photographs_among(names) == names
    assert not mask_places(names)
    assert photographs_among(["masks/1.png", "a.jpg"]) == ["a.jpg"]


def test_of_two_photographs_with_one_name_neither_gets_a_mask_by_its_name_alone():
    pictures = ["a/1.jpg", "b/1.jpg", "masks/1.png"]
    problems = Problems()
    assert masks_of(pictures[:2], pictures, problems) == {}
    assert [each.code for each in problems.findings()] == ["scene.mask_unused"]
    told_apart = ["a/1.jpg", "b/1.jpg", "masks/a/1.png", "masks/b/1.png"]
    assert masks_of(pictures[:2], told_apart, Problems()) == dict(
        zip(told_apart[:2], told_apart[2:], strict=True)
    )


def test_a_second_set_of_masks_is_named():
    pictures = ["1.jpg", "2.jpg", "masks/1.png", "masks/2.png", "segmentation/1.png", "segmentation/2.png"]
    problems = Problems()
    assert masks_of(pictures[:2], pictures, problems) == {"1.jpg": "masks/1.png", "2.jpg": "masks/2.png"}
    assert "other masks are used" in problems.findings()[0].message


def test_the_search_for_cameras_uses_the_same_masks(tmp_path):
    from lambent_capture.poses.photographs import find_photographs

    write(tmp_path, "image/{}.jpg", "mask/{}.png")
    problems = Problems()
    found = find_photographs(tmp_path, None, problems)
    assert found is not None, [each.message for each in problems.findings()]
    assert found.names == photographs_in(tmp_path, Problems())
    assert found.masks == {f"image/{stem}.jpg": tmp_path / f"mask/{stem}.png" for stem in STEMS}
