"""A sample of the combinations that `make strangers` draws by the thousand."""

from pathlib import Path

import numpy as np
import pytest
from strangers import fuzz, reading
from strangers.captures import Case, write_capture
from strangers.pictures import Spec

pytestmark = pytest.mark.slow

COUNT, SEED = 150, 20
RIGHT = (reading.RIGHT, reading.REFUSED)


@pytest.mark.parametrize("number", range(COUNT))
def test_a_capture_shows_the_light_of_the_reference_or_is_refused_clearly(number: int, tmp_path: Path):
    case = fuzz.case_of(number, SEED)
    found = fuzz.outcome_of(case, tmp_path / "scene")
    assert found.kind in RIGHT, f"{case}: {found.why}"


def test_what_is_not_light_in_linear_units_is_among_the_sample_and_is_refused(tmp_path: Path):
    cases = [fuzz.case_of(number, SEED) for number in range(COUNT)]
    refused = [case for case in cases if not case.spec.statement.means]
    assert len(refused) >= 5
    found = fuzz.outcome_of(refused[0], tmp_path / "scene")
    assert found.kind == reading.REFUSED


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("light", lambda view: view * np.float32([1.05, 1.0, 1.0, 1.0])),
        ("alpha", lambda view: view * np.float32([1.0, 1.0, 1.0, 0.9])),
        ("rows", lambda view: view[::-1]),
        ("size", lambda view: view[:-1]),
    ],
)
def test_a_reader_that_is_wrong_is_noticed(name: str, change, tmp_path: Path, monkeypatch):
    written = write_capture(tmp_path / "scene", Case(spec=Spec(format="png", alpha="straight")))
    true = reading.trained

    def wrong(given):
        views, manifest = true(given)
        return {path: np.ascontiguousarray(change(view)) for path, view in views.items()}, manifest

    assert reading.outcome_of(written).kind == reading.RIGHT
    monkeypatch.setattr(reading, "trained", wrong)
    assert reading.outcome_of(written).kind == reading.SILENT, name


def test_a_traceback_is_no_refusal(tmp_path: Path, monkeypatch):
    written = write_capture(tmp_path / "scene", Case(spec=Spec(format="png")))
    monkeypatch.setattr(reading, "observe", lambda *_: 1 / 0)
    assert reading.outcome_of(written).kind == reading.TRACEBACK


def test_a_number_and_a_seed_make_the_same_capture_again(tmp_path: Path):
    for number in range(12):
        case = fuzz.case_of(number, SEED)
        assert case == fuzz.case_of(number, SEED)
        files = []
        for place in ("one", "other"):
            write_capture(tmp_path / place / str(number), case)
            paths = sorted(path for path in (tmp_path / place / str(number)).rglob("*") if path.is_file())
            files.append([path.read_bytes() for path in paths])
        assert files[0] == files[1]
