"""Small files of ours are written whole and read without surprises."""

import pytest
from lambent_core.files import read_record, write_json


def test_json_is_replaced_whole_and_leaves_no_temporary_file(tmp_path):
    write_json(tmp_path / "a.json", {"x": 1})
    write_json(tmp_path / "a.json", {"x": 2})
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
    assert read_record(tmp_path / "a.json") == {"x": 2}


@pytest.mark.parametrize("text", ["", "[1]", "{"])
def test_a_damaged_record_counts_as_none(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    assert read_record(tmp_path / "a.json") == {}
