"""Results of an earlier run are used where they were made from the same inputs, and removed otherwise."""

from pathlib import Path

import pytest
from lambent_core.files import file_sha256, write_json
from lambent_run.run.folder import begin_task
from lambent_run.run.hashes import input_hashes, scene_hash
from lambent_run.run.kept import drop_unfitting, note_made_from
from lambent_run.run.preparation import files_hash
from lambent_run.run.spec import RunSpec
from support.photographs import write_views

HASHES = {"cameras": "c", "ingest": "i", "masks": "m"}


def brought(run: Path, cameras: str, masks: str, workspace: str) -> None:
    """Write what a server offers, made from these inputs."""
    for folder in ("cameras/sparse/0", "estimated_masks/masks", "estimated_masks/workspace"):
        (run / folder).mkdir(parents=True)
        (run / folder / "file").write_text("x")
    write_json(run / "cameras" / "cameras.json", {"inputs": cameras})
    note_made_from(run / "estimated_masks", masks)
    note_made_from(run / "estimated_masks" / "workspace", workspace)


def left(run: Path) -> set[str]:
    """Return the folders that still have their file."""
    return {path.parent.relative_to(run).as_posix() for path in run.rglob("file")}


ALL = {"cameras/sparse/0", "estimated_masks/masks", "estimated_masks/workspace"}


@pytest.mark.parametrize(
    ("made_from", "expected"),
    [
        (("c", "m", "i"), ALL),
        (("other", "m", "i"), ALL - {"cameras/sparse/0"}),
        (("c", "other", "i"), ALL - {"estimated_masks/masks"}),
        (("c", "other", "other"), {"cameras/sparse/0"}),
    ],
)
def test_only_what_was_made_from_the_same_is_left(tmp_path, made_from, expected):
    brought(tmp_path, *made_from)
    drop_unfitting(tmp_path, HASHES)
    assert left(tmp_path) == expected
    assert (tmp_path / "estimated_masks" / "made_from.json").is_file() == (made_from[1] == "m")


def test_found_cameras_are_no_use_to_a_run_whose_capture_has_its_own(tmp_path):
    brought(tmp_path, "c", "m", "i")
    drop_unfitting(tmp_path, {"ingest": "i", "masks": "m"})
    assert "cameras/sparse/0" not in left(tmp_path)


def test_what_the_run_has_begun_itself_is_left_alone(tmp_path):
    brought(tmp_path, "other", "other", "other")
    for task in ("cameras", "masks"):
        begin_task(tmp_path, task, "anything")
    drop_unfitting(tmp_path, HASHES)
    assert left(tmp_path) == ALL


def test_the_hash_of_a_capture_follows_from_the_hashes_of_its_files(tmp_path):
    write_views(tmp_path / "a-b")
    write_views(tmp_path / "a", count=2)
    (tmp_path / ".hidden").write_text("x")
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    listed = [(path.relative_to(tmp_path).as_posix(), file_sha256(path)) for path in files]
    assert files_hash(reversed(listed)) == scene_hash(tmp_path)
    assert files_hash(each for each in listed if each[0] != "a/IMG_0001.jpg") != scene_hash(tmp_path)


def test_the_seed_decides_over_cameras_and_masks_of_photographs_alone(tmp_path):
    write_views(tmp_path)
    one, two = (input_hashes(RunSpec.from_options(tmp_path, preset="tiny", seed=seed)) for seed in (0, 1))
    assert one["cameras"] != two["cameras"]
    assert one["masks"] != two["masks"]
