"""Looking at photographs: figures of each, and of all together."""

import base64
import io

import numpy as np
import pytest
from lambent_capture.checks.photograph_limits import PhotographLimits
from lambent_capture.checks.photographs import look
from PIL import Image, ImageFilter
from support.photographs import view, write_views

LIMITS = PhotographLimits()


def test_each_photograph_is_announced_before_it_is_read_and_the_end_too(tmp_path):
    write_views(tmp_path, 3)
    heard = []
    look(tmp_path, ["IMG_0000.jpg", "IMG_0001.jpg"], LIMITS, heard.append)
    assert heard == ["IMG_0000.jpg", "IMG_0001.jpg", ""]


def test_a_photograph_that_brought_a_reader_down_is_not_opened_again(tmp_path):
    write_views(tmp_path, 3)
    (tmp_path / "IMG_0001.jpg").unlink()
    figures = look(
        tmp_path, ["IMG_0000.jpg", "IMG_0001.jpg"], LIMITS, skip={"IMG_0001.jpg": "scene.image_too_large"}
    )
    assert figures.left_out == ("IMG_0001.jpg",)
    assert figures.photographs[1].fault == "scene.image_too_large"


def test_sharpness_is_relative_and_falls_with_blur(tmp_path):
    write_views(tmp_path, 4)
    blurred = view(0).filter(ImageFilter.GaussianBlur(1.5))
    blurred.save(tmp_path / "soft.jpg", quality=95)
    names = [f"IMG_{index:04d}.jpg" for index in range(4)] + ["soft.jpg"]
    figures = look(tmp_path, names, LIMITS)
    sharpness = {each.name: each.sharpness for each in figures.photographs}
    assert min(sharpness[name] for name in names[:4]) > 0.8
    assert sharpness["soft.jpg"] < 0.6 * min(sharpness[name] for name in names[:4])


def write_masks(folder, count):
    """Write black pictures with a white square, and return their names."""
    names = [f"MASK_{index:04d}.png" for index in range(count)]
    for index, name in enumerate(names):
        mask = Image.new("L", (192, 144))
        mask.paste(255, (40 + index, 30, 140, 110))
        mask.save(folder / name)
    return names


def of_portrait(figures):
    """Return the colours of a portrait, [row, column, 3]."""
    with Image.open(io.BytesIO(base64.b64decode(figures.portrait))) as image:
        return np.asarray(image.convert("RGB"), np.float32)


def test_a_mask_among_photographs_never_stands_for_them(tmp_path):
    write_views(tmp_path, 2)
    photographs = ["IMG_0000.jpg", "IMG_0001.jpg"]
    alone = look(tmp_path, photographs, LIMITS)
    masks = write_masks(tmp_path, 2)
    among = look(tmp_path, [*masks, *photographs], LIMITS)
    assert among.left_out == tuple(masks)
    assert among.portrait == alone.portrait
    assert of_portrait(among).std(axis=(0, 1)).min() > 5.0


@pytest.mark.parametrize("level", [0, 255])
def test_the_mask_of_a_photograph_without_the_object_does_not_stand_for_all(tmp_path, level):
    write_views(tmp_path, 1)
    Image.new("L", (192, 144), level).save(tmp_path / "0000_mask.png")
    alone, among = (
        look(tmp_path, [*masks, "IMG_0000.jpg"], LIMITS).portrait for masks in ([], ["0000_mask.png"])
    )
    assert among == alone


def test_the_first_picture_stands_for_all_where_all_look_like_masks(tmp_path):
    figures = look(tmp_path, write_masks(tmp_path, 2), LIMITS)
    assert figures.left_out == ()
    assert of_portrait(figures)[60, 90].min() > 240.0


def test_copies_and_views_that_repeat_are_named_by_the_first(tmp_path):
    write_views(tmp_path, 2)
    (tmp_path / "copy.jpg").write_bytes((tmp_path / "IMG_0000.jpg").read_bytes())
    view(1).save(tmp_path / "again.jpg", quality=60)
    figures = look(tmp_path, ["IMG_0000.jpg", "IMG_0001.jpg", "copy.jpg", "again.jpg"], LIMITS)
    found = {each.name: (each.same_as, each.is_copy) for each in figures.photographs}
    assert found["copy.jpg"] == ("IMG_0000.jpg", True)
    assert found["again.jpg"] == ("IMG_0001.jpg", False)
    assert not found["IMG_0000.jpg"][0]
    assert not found["IMG_0001.jpg"][0]


def test_an_object_that_turns_before_a_still_camera_is_not_the_same_view(tmp_path):
    background = view(0)
    names = [f"{index}.jpg" for index in range(4)]
    for index, name in enumerate(names):
        picture = background.copy()
        picture.paste(view(10 + index).resize((48, 36)), (70, 50))
        picture.save(tmp_path / name, quality=92)
    assert not any(each.same_as for each in look(tmp_path, names, LIMITS).usable)


def test_the_thumbnails_are_small(tmp_path):
    write_views(tmp_path, 2)
    figures = look(tmp_path, ["IMG_0000.jpg", "IMG_0001.jpg"], LIMITS)
    assert {len(each) < 64 * 1024 for each in figures.thumbnails.values()} == {True}
