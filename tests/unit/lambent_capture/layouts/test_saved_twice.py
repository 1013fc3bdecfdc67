"""Of the files that a camera or a program writes of one photograph, one is used."""

import pytest
from lambent_capture.layouts import saved_twice
from lambent_capture.layouts.saved_twice import one_of_each
from lambent_capture.problems import Problems

PAIRS = {
    "raw and JPEG": ("IMG_1.dng", "IMG_1.JPG"),
    "Pixel, raw": ("PXL_2023.RAW-02.ORIGINAL.dng", "PXL_2023.RAW-01.COVER.jpg"),
    "Pixel, raw in motion": ("PXL_2023.RAW-02.ORIGINAL.dng", "PXL_2023.RAW-01.MP.COVER.jpg"),
    "Pixel, raw at night": ("PXL_2023.NIGHT.RAW-02.ORIGINAL.dng", "PXL_2023.NIGHT.RAW-01.COVER.jpg"),
    "Pixel, portrait": ("PXL_2023.PORTRAIT-02.ORIGINAL.jpg", "PXL_2023.PORTRAIT-01.COVER.jpg"),
    "Pixel, series": ("IMG_2018_BURST001.jpg", "IMG_2018_BURST001_COVER.jpg"),
    "Google, portrait": ("00000PORTRAIT_00000_BURST2019.jpg", "00100dPORTRAIT_00100_BURST2019_COVER.jpg"),
    "iOS, edited": ("IMG_1234.HEIC", "IMG_E1234.JPG"),
    "iOS, edited HEIC": ("IMG_1234.JPG", "IMG_E1234.HEIC"),
    "edited on the telephone": ("PXL_2023.jpg", "PXL_2023~2.jpg"),
    "edited in Google Photos": ("IMG_1.jpg", "IMG_1-edited.jpg"),
    "HEIC and JPEG": ("a/IMG_1.heic", "a/img_1.jpg"),
}


@pytest.fixture
def develop(monkeypatch):
    """Return a function that says whether raw files can be read."""
    return lambda can: monkeypatch.setattr(saved_twice, "raw_available", lambda: can)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS.keys())
def test_the_original_is_used_and_the_other_file_is_named(develop, pair):
    develop(True)
    problems = Problems()
    assert one_of_each(pair, problems) == (pair[0],)
    (finding,) = problems.findings()
    assert (finding.code, finding.subject) == ("scene.saved_twice", pair[1])


@pytest.mark.parametrize("pair", [pair for pair in PAIRS.values() if pair[0].endswith("dng")])
def test_without_a_reader_of_raw_files_the_other_file_is_used(develop, pair):
    develop(False)
    assert one_of_each(pair, Problems()) == (pair[1],)


def test_raw_files_are_used_only_where_every_photograph_has_one(develop):
    develop(True)
    names = ["a.dng", "a.jpg", "b.dng", "b.jpg"]
    assert one_of_each(names, Problems()) == ("a.dng", "b.dng")
    assert one_of_each([*names, "c.jpg"], Problems()) == ("a.jpg", "b.jpg", "c.jpg")
    assert one_of_each([*names, "c.dng"], Problems()) == ("a.dng", "b.dng", "c.dng")


def test_photographs_of_their_own_are_all_used(develop):
    develop(True)
    names = (
        "00000IMG_00000_BURST2018.jpg",
        "00001IMG_00001_BURST2018.jpg",
        "IMG_1.jpg",
        "IMG_1234.jpg",
        "IMG_E1235.jpg",
        "IMG_2018_BURST001.jpg",
        "IMG_2018_BURST002.jpg",
        "PXL_2023.RAW-01.COVER.jpg",
        "PXL_2024.RAW-01.COVER.jpg",
        "b/IMG_1.jpg",
        "house (1).jpg",
        "house.jpg",
    )
    problems = Problems()
    assert one_of_each(names, problems) == tuple(sorted(names))
    assert not problems.findings()
