"""`lambent masks --edit`: from photographs to corrected masks that training takes."""

import http.client
import json
import threading
from functools import partial
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
import typer
from lambent_capture.editor import session
from lambent_capture.pictures.mask_levels import read_mask
from lambent_core.files import read_record
from lambent_run.commands import masks as masks_cli
from lambent_run.run.folder import begin_task, done_inputs
from lambent_run.run.hashes import input_hashes
from lambent_run.run.spec import RunSpec, keep_run, read_run, with_kept_corrections
from lambent_run.run.tasks import masks as masks_task
from support.ball_photographs import write_ball_photographs, write_masks
from typer.testing import CliRunner


def call(*arguments):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(masks_cli.masks)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture
def visits(monkeypatch, tmp_path):
    """Let a user who sends the corrections in the returned list press Done whenever a page is opened."""
    sent = []
    (tmp_path / "masks.html").write_text("page")

    def open_page(url):
        parts = urlsplit(url)
        key = parse_qs(parts.fragment)["key"][0]

        def press():
            connection = http.client.HTTPConnection(parts.hostname, parts.port)
            body = json.dumps({"version": 1, "corrections": sent})
            connection.request("POST", f"/edit/{key}/finish", body, {"content-type": "application/json"})
            assert connection.getresponse().status == 200
            connection.close()

        threading.Thread(target=press).start()

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(
        session, "correct_masks", partial(session.correct_masks, open_page=open_page, pages=tmp_path)
    )
    return sent


@pytest.mark.slow
def test_a_person_corrects_the_masks_of_a_run_and_training_takes_them(tmp_path, visits, monkeypatch):
    rows, columns = np.nonzero(write_ball_photographs(tmp_path / "scene", count=8)["train_r_3"])
    x, y = float(round(columns.mean())), float(round(rows.mean()))
    box = {"frame": "train_r_3", "label": "background", "box": [x - 6, y - 6, x + 6, y + 6]}
    inner = np.s_[int(y) - 4 : int(y) + 4, int(x) - 4 : int(x) + 4]
    searches = []
    find = masks_task.find_object

    def counted(*given, **named):
        searches.append(1)
        return find(*given, **named)

    monkeypatch.setattr(masks_task, "find_object", counted)
    run = tmp_path / "run"
    visits.append(box)
    result = call(tmp_path / "scene", "-o", run, "--edit")
    assert result.exit_code == 0, result.output
    assert f"lambent train {tmp_path / 'scene'} -o {run}" in result.stdout
    assert json.loads((run / "corrections.json").read_text())["corrections"] == [box]
    mask = read_mask(run / "estimated_masks" / "masks" / "train_r_3.png").coverage
    assert (mask[inner] < 0.5).all()
    spec = with_kept_corrections(RunSpec.from_options(tmp_path / "scene", preset="tiny"), run)
    assert done_inputs(run, "masks") == input_hashes(spec)["masks"]
    assert 0.0 < read_record(run / "estimated_masks" / "agreement.json")["overlap"] <= 1.0

    visits.clear()
    result = call(tmp_path / "scene", "-o", run, "--edit")
    assert result.exit_code == 0, result.output
    assert not read_run(run)[0].corrections
    assert read_mask(run / "estimated_masks" / "masks" / "train_r_3.png").coverage[inner].all()
    assert len(searches) == 1

    begin_task(run, "cache", "inputs")
    result = call(tmp_path / "scene", "-o", run, "--edit")
    assert result.exit_code == 2
    assert "run.training_begun" in result.stderr


def test_masks_that_are_not_estimated_are_not_edited(tmp_path, visits):
    true = write_ball_photographs(tmp_path / "scene", count=3)
    masks = write_masks(tmp_path / "cut", true)
    keep_run(tmp_path / "run", RunSpec.from_options(tmp_path / "scene", preset="tiny", masks=masks), "cpu")
    result = call(tmp_path / "scene", "-o", tmp_path / "run", "--edit")
    assert result.exit_code == 2
    assert "config.corrections_unused" in result.stderr
    result = call(tmp_path / "scene", "-o", tmp_path / "other", "--edit", "--segmenter", "x:y")
    assert result.exit_code == 2
    assert "config.edit_segmenter" in result.stderr
