"""Files that a capture must not hold are named and never loaded."""

import pytest
from lambent_capture.loading.inspect import inspect_files
from support.captures import (
    write_blender,
    write_tensoir,
)
from support.findings import subject_of, warnings_of

UNSUPPORTED = {
    "cameras.pkl": b"\x80\x04K\x01.",
    "weights.pth": b"PK\x03\x04",
    "model.onnx": b"\x08\x09",
    "run.sh": b"#!/bin/sh\n",
    "notes.txt": b"\x7fELF\x02\x01\x01",
    "readme": b"\x80\x04\x95",
    "setup.exe": b"MZ\x90\x00",
}


@pytest.mark.parametrize(("name", "content"), UNSUPPORTED.items())
def test_files_that_could_run_are_named_and_never_opened_for_use(tmp_path, name, content):
    folder = write_tensoir(tmp_path)
    (folder / "extra").mkdir()
    (folder / "extra" / name).write_bytes(content)
    report = inspect_files(folder).report
    assert report.usable
    assert warnings_of(report) == ["scene.unsupported_file"]
    assert subject_of(report, "scene.unsupported_file") == f"extra/{name}"


def test_a_pickle_in_place_of_a_picture_is_refused_without_being_loaded(tmp_path):
    folder = write_blender(tmp_path)
    trap = tmp_path / "loaded"
    payload = b"\x80\x04cos\nsystem\n(V" + f"touch {trap}".encode() + b"\ntR."
    (folder / "train" / "r_0.png").write_bytes(payload)
    report = inspect_files(folder).report
    assert warnings_of(report) == ["scene.pictures_left_out", "scene.unsupported_file"]
    assert not trap.exists()
