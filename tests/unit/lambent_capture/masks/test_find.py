"""An object on a table is found without its shadow and the table's pattern."""

from functools import cache

import numpy as np
import pytest
from lambent_capture.masks.consensus import MaskView
from lambent_capture.masks.corrections import Correction, corrections_from
from lambent_capture.masks.final import FinalSettings, colours_of, final_mask, preview_masks
from lambent_capture.masks.find import FindSettings, _moved, find_object
from lambent_capture.masks.on_support import SupportSettings, find_on_support, first_footprint, ortho_grid
from lambent_capture.masks.orthophoto import look_at_support
from lambent_capture.masks.propagate import propagated
from lambent_capture.masks.support_plane import PlaneSettings, find_support
from lambent_capture.masks.workspace import Workspace
from lambent_core.errors import WorkerError
from support.ball_on_table import BallOnTable, ball_on_table

SECOND = np.array([0.1, -0.85, 0.25])


@cache
def plain() -> tuple[BallOnTable, Workspace]:
    capture = ball_on_table(12, distortion=(-0.04, 0.01))
    work = find_object(capture.photographs, capture.points, FindSettings())
    return capture, work


@cache
def with_a_second_ball() -> tuple[BallOnTable, Workspace]:
    capture = ball_on_table(12, block=SECOND)
    return capture, find_object(capture.photographs, capture.points, FindSettings())


def overlaps(found: list[np.ndarray], true: list[np.ndarray]) -> np.ndarray:
    return np.array([(a & b).sum() / (a | b).sum() for a, b in zip(found, true, strict=True)])


@pytest.mark.long
@pytest.mark.slow
def test_the_ball_is_found_without_its_shadow_whatever_the_exposure():
    capture, work = plain()
    assert work.has_support
    colours = colours_of(work)
    found = [
        final_mask(photograph, number, work, colours, FinalSettings()) >= 128
        for number, photograph in enumerate(capture.photographs)
    ]
    assert overlaps(found, capture.masks).min() > 0.93
    assert overlaps(found, capture.masks).mean() > 0.96


@pytest.mark.long
@pytest.mark.slow
def test_what_is_marked_on_four_photographs_is_taken_away_from_all():
    capture, work = with_a_second_ball()
    before = [
        (mask & block).sum() / max(block.sum(), 1)
        for mask, block in zip(preview_masks(work), capture.blocks, strict=True)
    ]
    assert np.median(before) > 0.8  # It is next to the ball and is found with it.
    # Where it is well beside the ball: rows of 2 pixels, so that nothing else is marked.
    clear = [i for i, block in enumerate(capture.blocks) if block.sum() > 550][:4]
    marks = [
        Correction(
            frame=f"v{number:02d}",
            is_object=False,
            points=tuple((float(place), row + 0.5) for place in np.flatnonzero(line)[[0, -1]] + 0.5),
            radius=1.0,
        )
        for number in clear
        for row, line in enumerate(capture.blocks[number])
        if line.any()
    ]
    corrected = propagated(work, marks)
    after = [
        (mask & block).sum() / max(block.sum(), 1)
        for mask, block in zip(preview_masks(corrected), capture.blocks, strict=True)
    ]
    assert np.median(after) < 0.15
    kept = [(m & b).sum() / b.sum() for m, b in zip(preview_masks(corrected), capture.masks, strict=True)]
    assert np.median(kept) > 0.9


@pytest.mark.slow
def test_no_corrections_are_the_estimate_and_marks_are_obeyed_where_they_are():
    _, work = plain()
    assert propagated(work, []) is work
    record = {
        "version": 1,
        "corrections": [
            {"frame": "v03", "label": "background", "box": [90, 60, 110, 80]},
            {"frame": "v03", "label": "object", "stroke": [[20, 20], [40, 20]], "radius": 4},
        ],
    }
    corrected = propagated(work, corrections_from(record))
    mask = preview_masks(corrected)[3]
    assert not mask[61:79, 91:109].any()
    assert mask[19:21, 20:40].all()


@pytest.mark.slow
def test_what_an_estimate_keeps_is_read_back(tmp_path):
    _, work = plain()
    work.save(tmp_path)
    again = Workspace.load(tmp_path)
    assert again.names == work.names
    assert all((a == b).all() for a, b in zip(again.support_odds, work.support_odds, strict=True))
    assert all((a == b).all() for a, b in zip(preview_masks(again), preview_masks(work), strict=True))


@cache
def like_the_table() -> tuple[BallOnTable, Workspace]:
    colours = (190, 170, 140), (165, 150, 125)
    capture = ball_on_table(12, ball=colours, spots=0.05)
    return capture, find_object(capture.photographs, capture.points, FindSettings())


@pytest.mark.slow
def test_an_object_of_the_tables_colours_keeps_its_foot_through_corrections_and_on_disk(tmp_path):
    capture, work = like_the_table()
    before = overlaps(preview_masks(work), capture.masks)
    assert before.mean() > 0.9
    work.save(tmp_path)
    mark = Correction(frame="v03", is_object=False, points=((10.0, 10.0), (30.0, 12.0)), radius=3.0)
    corrected = propagated(Workspace.load(tmp_path), [mark])
    assert overlaps(preview_masks(corrected), capture.masks).mean() > before.mean() - 0.01


def missing(mask: np.ndarray, found: np.ndarray, frame: str) -> list[Correction]:
    """Return strokes over what a mask has of the object and `found` has not."""
    part = mask & ~found
    return [
        Correction(
            frame=frame,
            is_object=True,
            points=tuple((float(place), row + 0.5) for place in np.flatnonzero(line)[[0, -1]] + 0.5),
            radius=0.6,
        )
        for row, line in enumerate(part)
        if line.any()
    ]


@pytest.mark.slow
def test_the_more_photographs_are_marked_the_better_are_all_of_them():
    capture, work = like_the_table()
    found = preview_masks(work)
    means = [overlaps(found, capture.masks).mean()]
    for marked in ((1, 4, 7, 10), (0, 1, 3, 4, 6, 7, 9, 10)):
        marks = [each for n in marked for each in missing(capture.masks[n], found[n], f"v{n:02d}")]
        means.append(overlaps(preview_masks(propagated(work, marks)), capture.masks).mean())
    assert means == sorted(means)
    assert means[-1] > means[0] + 0.02


@pytest.mark.slow
def test_what_never_moved_before_a_turntables_camera_is_not_the_object():
    capture, _ = with_a_second_ball()
    views = [photograph.reduced(200) for photograph in capture.photographs]
    positions = np.array([view.camera.position for view in views])
    middle, distance = np.array([0.0, 0.0, 0.6]), 4.0
    plane = find_support(capture.points.xyz, positions, middle, distance, PlaneSettings())
    assert plane is not None
    settings = SupportSettings()
    grid = ortho_grid(plane, views, distance, settings)
    support = look_at_support(views, grid)
    footprint = first_footprint(grid, capture.points.xyz, distance, settings)

    def shares(moved: list[np.ndarray] | None) -> list[float]:
        found = find_on_support(views, support, footprint, middle, distance, settings, moved=moved)
        assert found is not None
        return [
            float(
                np.median(
                    [b[t].mean() for b, t in zip(found.agreement.beliefs, true, strict=True) if t.any()]
                )
            )
            for true in (capture.masks, capture.blocks)
        ]

    ball, block = shares(None)
    assert ball > 0.8
    assert block > 0.8
    ball, block = shares([~each for each in capture.blocks])
    assert ball > 0.8
    assert block < 0.1


def test_a_folder_without_an_estimate_says_so(tmp_path):
    with pytest.raises(WorkerError, match=r"scene\.mask_estimate_stale"):
        Workspace.load(tmp_path)
    (tmp_path / "estimate.json").write_text('{"version": 0}')
    with pytest.raises(WorkerError, match="version 0"):
        Workspace.load(tmp_path)


def test_work_is_told_and_can_be_stopped():
    capture = ball_on_table(count=8)
    told = []

    def progress(phase: str, done: int, total: int) -> None:
        told.append((phase, done, total))
        if phase == "looking at the support" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_object(capture.photographs, capture.points, FindSettings(), progress)
    assert told == [("reading photographs", n + 1, 8) for n in range(8)] + [
        ("looking at the support", n + 1, 8) for n in range(2)
    ]


def test_what_turned_is_looked_for_where_anything_ever_changed():
    generator = np.random.default_rng(0)
    room = generator.integers(40, 220, (60, 80, 3)).astype(np.uint8)
    camera = plain()[0].photographs[0].camera.resized(80, 60)
    views = []
    for number in range(12):
        picture = room.copy()
        picture[20:45, 30:50] = (180, 40, 30)  # Of one colour from all sides: nothing changes here ...
        picture[26:42, 26 + 2 * number : 32 + 2 * number] = (20, 20, 200)  # ... but where this passes.
        views.append(MaskView(f"v{number}", picture, camera))
    moved = _moved(views)
    assert moved is not None
    assert all(np.array_equal(each, moved[0]) for each in moved)
    assert moved[0][26:42, 30:40].all()
    assert not moved[0][:14].any()
    assert not moved[0][:, 60:].any()
    assert _moved([MaskView(f"v{k}", room, camera) for k in range(12)]) is None
