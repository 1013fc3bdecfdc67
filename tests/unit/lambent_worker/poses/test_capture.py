"""A capture is written whole from found cameras; what others put into its folder stays."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from lambent_worker.commands.poses import ShownProgress
from lambent_worker.errors import SceneRefusedError, Stopped, UsageError
from lambent_worker.poses import capture
from lambent_worker.poses.solution import Solution
from lambent_worker.poses.solve import PoseSettings
from PIL import Image
from support.captures import save


@pytest.fixture
def photographs(tmp_path):
    """Return a folder of four photographs with masks."""
    for number in range(4):
        save(tmp_path / "in" / "images" / f"{number}.png", np.full((8, 8, 3), 60 * number, dtype=np.uint8))
        save(tmp_path / "in" / "masks" / f"{number}.png", np.full((8, 8), 255, dtype=np.uint8))
    return tmp_path / "in"


@pytest.fixture
def solved(monkeypatch):
    """Replace the search by one that finds three cameras, and return the settings that it was called with."""
    called = []

    def solve(photographs, work, settings, progress):
        called.append(settings)
        work.mkdir(parents=True, exist_ok=True)
        progress("features", 0, 4)
        model = work / "sparse" / "0"
        model.mkdir(parents=True, exist_ok=True)
        pycolmap.Reconstruction().write_binary(model)
        poses = {name: np.eye(4) for name in photographs.names[:3]}
        features = (2000,) * len(photographs.names)
        return Solution(
            names=photographs.names,
            features=features,
            partners={},
            camera_to_world=poses,
            faults={},
            model=model,
        )

    monkeypatch.setattr(capture, "solve_apart", solve)
    return called


def test_photographs_with_cameras_are_copied_with_their_masks(photographs, solved, tmp_path):
    out = tmp_path / "out"
    record = capture.solve_capture(photographs, out)
    assert (record["registered"], record["missing"]) == (3, ["3.png"])
    made = sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file())
    assert [name for name in made if not name.startswith("sparse/")] == [
        *(f"images/{number}.png" for number in range(3)),
        *(f"masks/{number}.png.png" for number in range(3)),
        "poses.json",
    ]
    with Image.open(out / "masks" / "1.png.png") as mask:
        assert np.asarray(mask).min() == 255
    assert capture.solve_capture(photographs, out) == record
    assert len(solved) == 1
    capture.solve_capture(photographs, out, settings=PoseSettings(seed=1))
    assert len(solved) == 2


def test_a_search_that_is_ended_leaves_nothing_but_what_it_goes_on_from(photographs, solved, tmp_path):
    def ended(phase, done, total):
        raise Stopped

    with pytest.raises(Stopped):
        capture.solve_capture(photographs, tmp_path / "out", progress=ended)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [capture.WORK]
    assert {path.name for path in tmp_path.iterdir()} == {"in", "out"}
    assert capture.solve_capture(photographs, tmp_path / "out")["registered"] == 3
    assert not (tmp_path / "out" / capture.WORK).exists()


def test_what_is_refused_leaves_nothing(photographs, solved, tmp_path, monkeypatch):
    found = capture.solve_apart

    def finding_none(*arguments):
        return replace(found(*arguments), camera_to_world={}, model=None)

    monkeypatch.setattr(capture, "solve_apart", finding_none)
    with pytest.raises(SceneRefusedError, match=r"scene\.poses_none"):
        capture.solve_capture(photographs, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("held", [("thesis.txt",), ("images/1.png", "sparse/0/images.bin")])
def test_a_folder_with_something_else_is_left_alone(photographs, solved, tmp_path, held):
    for name in held:
        (tmp_path / "out" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "out" / name).write_text("")
    with pytest.raises(UsageError, match=r"config\.poses_folder"):
        capture.solve_capture(photographs, tmp_path / "out")
    assert all((tmp_path / "out" / name).is_file() for name in held)


def test_progress_is_shown_and_stops_when_asked_to(capsys):
    shown = ShownProgress()
    for done in range(5):
        shown("features", done, 4)
    shown("pairs", 0, 90)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "0 of 4 photographs looked at"
    assert lines[-2:] == ["4 of 4 photographs looked at", "0 of 90 pairs matched"]
    shown.stop()
    with pytest.raises(Stopped):
        shown("pairs", 1, 90)
