"""What a run was asked to do survives in its folder."""

import json

import pytest
from lambent_worker.errors import UsageError
from lambent_worker.files import read_record, write_json
from lambent_worker.run.folder import RunSettings, read_settings, write_settings

SETTINGS = RunSettings(
    preset="fast", config={"max_side": 128}, seed=3, device="cpu", lights=("a", "b"), layout="", scene="/s"
)


def test_settings_are_read_as_they_were_written(tmp_path):
    write_settings(tmp_path / "run", SETTINGS)
    found = read_settings(tmp_path / "run")
    assert found == SETTINGS
    assert (found.scene, found.device) == ("/s", "cpu")
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["versions"]["lambent"]


def test_a_moved_scene_or_another_device_is_the_same_run(tmp_path):
    other = RunSettings(
        preset="fast", config={"max_side": 128}, seed=3, device="cuda", lights=("a", "b"), scene="/t"
    )
    assert other == SETTINGS


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"schema_version": 1}', "{"])
def test_a_folder_without_a_run_is_a_usage_error(tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(UsageError, match=r"run\.not_found"):
        read_settings(tmp_path)


def test_a_run_of_another_major_version_is_refused(tmp_path):
    write_settings(tmp_path, SETTINGS)
    record = json.loads((tmp_path / "run.json").read_text())
    write_json(tmp_path / "run.json", {**record, "schema_version": "2.0"})
    with pytest.raises(UsageError, match=r"run\.version"):
        read_settings(tmp_path)


def test_json_is_replaced_whole_and_leaves_no_temporary_file(tmp_path):
    write_json(tmp_path / "a.json", {"x": 1})
    write_json(tmp_path / "a.json", {"x": 2})
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert read_record(tmp_path / "a.json") == {"x": 2}


@pytest.mark.parametrize("text", ["", "[1]", "{"])
def test_a_damaged_record_counts_as_none(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    assert read_record(tmp_path / "a.json") == {}
