"""Names of previews by which the server and the pages tell them apart: those that the worker gives."""

from pathlib import Path

from lambent_run.run import live_preview
from lambent_run.run.tasks import evaluate
from lambent_server.jobs import previews as preview_rows

STORE = Path(__file__).parents[2] / "client" / "web" / "src" / "jobs" / "store.ts"


def test_the_sheet_of_an_evaluation_has_one_name():
    assert preview_rows.SHEET == evaluate.SHEET
    assert f'const sheet = "{evaluate.SHEET}";' in STORE.read_text(encoding="utf-8")


def test_turning_pictures_begin_with_what_the_server_thins_out():
    assert live_preview.NAME.format(task="cache").startswith(preview_rows.TURNING)
    assert not evaluate.SHEET.startswith(preview_rows.TURNING)
