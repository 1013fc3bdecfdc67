"""The table and the sheet of a batch."""

import csv

import numpy as np
import pytest
from lambent_core.colour import srgb_from_linear
from lambent_core.exr import write_exr
from lambent_relight.batch.journal import MadeFile
from lambent_relight.batch.plan import Failure
from lambent_relight.batch.reading import read_manifest
from lambent_relight.batch.run import Result
from lambent_relight.batch.sheet_lights import SIDE, light_pictures
from lambent_relight.batch.summary import COLUMNS, MARGIN, TILE, thumbnail, write_sheets, write_table
from lambent_relight.environment.maps import write_environment
from lambent_relight.environment.probes import GREY
from PIL import Image
from support.small_batch import record

RED = (220, 30, 20)


def result(folder, path, suffix="png", size=(8, 6)):
    """Return a picture that was made: red all over."""
    target = folder / f"{path}.{suffix}"
    target.parent.mkdir(parents=True, exist_ok=True)
    if suffix == "png":
        Image.new("RGB", size, RED).save(target)
    else:
        planes = {"R": 0.5, "G": 0.0, "B": 0.0, "A": 1.0}
        write_exr(target, {name: np.full(size[::-1], value, np.float32) for name, value in planes.items()})
    made = MadeFile(path=f"{path}.{suffix}", key="k", sha256="s", size_bytes=1)
    return Result(path=path, state="made", record=record(path, {suffix: made}, size))


FAILED = Result(path="a/z", state="failed", failure=Failure(path="a/z", code="x.y", message="why, indeed"))


def test_the_table_has_a_line_for_every_picture_in_the_order_of_their_names(tmp_path):
    write_table(tmp_path / "t.csv", [FAILED, result(tmp_path, "a/b")])
    with (tmp_path / "t.csv").open(newline="") as file:
        reader = csv.DictReader(file)
        lines = list(reader)
    assert tuple(reader.fieldnames) == COLUMNS
    assert [line["picture"] for line in lines] == ["a/b", "a/z"]
    assert (lines[0]["seconds"], lines[0]["relative_standard_error"], lines[0]["png"]) == (
        "1.250",
        "0.05",
        "a/b.png",
    )
    assert (lines[1]["code"], lines[1]["message"]) == ("x.y", "why, indeed")


@pytest.mark.parametrize("suffix", ["png", "exr"])
def test_a_thumbnail_keeps_its_shape_and_colour_and_fits(tmp_path, suffix):
    found = thumbnail(tmp_path, result(tmp_path, "a/b", suffix, size=(400, 100)))
    assert found.size == (TILE, TILE // 4)
    red, green, _ = found.getpixel((5, 5))
    assert red > 150
    assert green < 60
    assert thumbnail(tmp_path, FAILED) is None


def test_transparent_pictures_stand_on_white(tmp_path):
    one = result(tmp_path, "a/b")
    Image.new("RGBA", (8, 8), (0, 0, 0, 0)).save(tmp_path / "a/b.png")
    assert thumbnail(tmp_path, one).getpixel((4, 4)) == (255, 255, 255)


def test_a_sheet_shows_every_picture_and_every_failure(tmp_path):
    (path,) = write_sheets(tmp_path, [FAILED, result(tmp_path, "a/b", size=(128, 128))], title="spring")
    assert path.name == "contact_sheet.png"
    with Image.open(path) as sheet:
        pixels = np.asarray(sheet.convert("RGB")).astype(int)
    middle = MARGIN + 18 + 18 + TILE // 2
    assert tuple(pixels[middle, MARGIN + TILE // 2]) == RED
    failed = pixels[middle + TILE // 4, MARGIN + TILE + 6 + TILE // 2]
    assert tuple(failed) == (247, 222, 218)


def test_many_pictures_make_several_sheets(tmp_path, monkeypatch):
    monkeypatch.setattr("lambent_relight.batch.summary.ROWS_OF_A_SHEET", 2)
    results = [result(tmp_path, f"a{group}/{n}") for group in range(3) for n in range(9)]
    paths = write_sheets(tmp_path, results, title="many")
    names = [path.name for path in paths]
    assert names == ["contact_sheet.png", "contact_sheet_2.png", "contact_sheet_3.png"]
    assert not list(tmp_path.glob(".partial*"))


def test_a_group_has_the_balls_of_its_environments_and_the_sheet_the_same_tiles(tmp_path):
    results = [result(tmp_path, "a/b"), result(tmp_path, "c/d")]
    ball = Image.new("RGBA", (64, 32), (1, 2, 3, 255))
    (plain,) = write_sheets(tmp_path, results, title="t")
    with Image.open(plain) as image:
        before = np.asarray(image).astype(int)
    (lit,) = write_sheets(tmp_path, results, title="t", lights={"e": ball, "another": ball})
    with Image.open(lit) as image:
        after = np.asarray(image).astype(int)
    shown = np.argwhere((after == (1, 2, 3)).all(axis=-1))
    assert len(shown) == 2 * 64 * 32, "each group shows its environment once"
    assert after.shape[0] == before.shape[0] + 2 * (32 + 6 - 18)
    for page in (before, after):
        assert ((page == RED).all(axis=-1)).sum() == ((before == RED).all(axis=-1)).sum()


def test_a_map_that_cannot_be_read_has_no_balls_and_stops_nothing(tmp_path):
    radiance = np.full((8, 16, 3), 0.5, np.float32)
    write_environment(tmp_path / "even.exr", radiance)
    (tmp_path / "broken.exr").write_bytes(b"no map")
    document = {
        "schema": "lambent-batch/1",
        "assets": ["x"],
        "environments": [{"map": "even.exr", "rotate_deg": [0, 90]}, "broken.exr", "gone.exr"],
        "cameras": ["all"],
    }
    found = light_pictures(read_manifest(document, tmp_path))
    assert sorted(found) == ["even_0", "even_90"]
    pixels = np.asarray(found["even_0"])
    assert pixels.shape == (SIDE, 2 * SIDE + SIDE // 8, 4)
    grey = round(255 * float(srgb_from_linear(np.float64(GREY))))
    assert abs(int(pixels[16, -16, 0]) - grey) <= 1, "the grey ball is middle grey, whatever the map's scale"
