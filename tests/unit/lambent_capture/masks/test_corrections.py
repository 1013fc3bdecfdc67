"""Corrections are read as written, refused where they make no sense, and drawn where they belong."""

import numpy as np
import pytest
from lambent_capture.masks.corrections import (
    Correction,
    corrections_from,
    read_corrections,
    record_of,
    reduced_seeds,
    seeds_of,
)
from lambent_core.errors import UsageError

STROKE = {"frame": "a", "label": "background", "stroke": [[10, 10], [30, 10]], "radius": 3}
BOX = {"frame": "a", "label": "object", "box": [5, 5, 35, 25]}


def seeds(*entries: dict, scale: tuple[float, float] = (1.0, 1.0)) -> np.ndarray:
    found = corrections_from({"version": 1, "corrections": list(entries)})
    return seeds_of(found, "a", (40, 30), scale)


def test_a_document_is_what_it_was_before_reading():
    record = {"version": 1, "corrections": [STROKE, BOX]}
    assert record_of(corrections_from(record)) == record


@pytest.mark.parametrize(
    "entry",
    [
        {"frame": 3, "label": "object", "box": [0, 0, 1, 1]},
        {"frame": "a", "label": "thing", "box": [0, 0, 1, 1]},
        {"frame": "a", "label": "object"},
        STROKE | {"box": [0, 0, 1, 1]},
        {"frame": "a", "label": "object", "box": [5, 5, 5, 9]},
        {"frame": "a", "label": "object", "box": [0, 0, 1]},
        {"frame": "a", "label": "object", "box": [0, 0, float("nan"), 1]},
        STROKE | {"radius": 0},
        STROKE | {"radius": None},
        STROKE | {"stroke": []},
        STROKE | {"stroke": [[1]]},
        STROKE | {"stroke": [[True, 1]]},
        "stroke",
    ],
)
def test_an_entry_that_makes_no_sense_is_refused(entry):
    with pytest.raises(UsageError, match=r"config\.corrections_invalid.*correction 0"):
        corrections_from({"version": 1, "corrections": [entry]})


@pytest.mark.parametrize("record", [None, [], {"version": 2, "corrections": []}, {"version": 1}])
def test_a_document_of_another_kind_is_refused(record):
    with pytest.raises(UsageError, match=r"config\.corrections_invalid"):
        corrections_from(record)


def test_a_file_that_is_no_json_is_refused(tmp_path):
    (tmp_path / "c.json").write_text("{")
    with pytest.raises(UsageError, match=r"config\.corrections_invalid"):
        read_corrections(tmp_path / "c.json")


def test_a_stroke_covers_its_width_and_no_more():
    drawn = seeds(STROKE)
    assert (drawn[8:12, 10:30] == -1).all()
    assert (drawn[15:] == 0).all()
    assert (drawn[:, 36:] == 0).all()
    assert abs((drawn == -1).sum() - (20 * 6 + np.pi * 9)) < 30


def test_an_object_box_rules_out_everything_around_it():
    drawn = seeds(BOX)
    assert (drawn[5:25, 5:35] == 0).all()
    assert (drawn[:5] == -1).all()
    assert (drawn[:, 35:] == -1).all()


def test_later_marks_go_before_earlier_ones_and_other_frames_have_none():
    erased = seeds(STROKE, STROKE | {"label": "object", "stroke": [[20, 10]]})
    assert erased[10, 20] == 1
    assert erased[10, 12] == -1
    assert (
        seeds_of([Correction(frame="b", is_object=True, points=((1, 1),), radius=2.0)], "a", (4, 4), (1, 1))
        is None
    )


def test_marks_are_scaled_with_the_picture_and_thin_ones_are_kept():
    half = seeds(BOX, scale=(0.5, 0.5))
    assert (half[3:12, 3:17] == 0).all()
    assert (half[13:] == -1).all()
    thin = reduced_seeds(seeds(STROKE | {"radius": 1}), (20, 15))
    assert (thin[4:6, 6:14] == -1).any(axis=0).all()
