"""A run whose cameras were found before a background that stood still says so when the object is cut out."""

from types import SimpleNamespace

import pytest
from lambent_capture.layouts.photographs import CAMERAS_FILE, FoundCameras
from lambent_run.run.tasks import masks


@pytest.mark.parametrize("stands", [True, False, None])
def test_the_search_knows_whether_the_background_stood_still(tmp_path, monkeypatch, stands):
    if stands is not None:
        found = FoundCameras(inputs="0", photographs=3, static_background=stands)
        (tmp_path / CAMERAS_FILE).write_text(found.model_dump_json())
    told = []
    monkeypatch.setattr(masks, "found_cameras", lambda run_dir: None if stands is None else tmp_path)
    for name in ("read_checked_manifest", "sparse_points", "photographs_of"):
        monkeypatch.setattr(masks, name, lambda *given: None)
    monkeypatch.setattr(masks, "find_object", lambda *given, still_background: told.append(still_background))
    masks._find(SimpleNamespace(spec=SimpleNamespace(scene=tmp_path), run_dir=tmp_path))
    assert told == [bool(stands)]
