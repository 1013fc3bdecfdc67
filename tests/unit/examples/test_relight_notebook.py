"""The notebook examples/relight.ipynb runs from its first cell to its last, and is kept without outputs."""

import ast
import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere

NOTEBOOK = Path(__file__).parents[3] / "examples" / "relight.ipynb"
SETTINGS = {"bundle_folder": "bundle", "side_px": 24, "spp": 8}


def code_cells() -> list[dict]:
    """Return the cells that hold code."""
    return [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]


def run_cell(source: str, names: dict) -> object:
    """Run a cell and return the value of its last line, as a notebook shows it."""
    tree = ast.parse(source)
    last = tree.body[-1]
    if isinstance(last, ast.Expr):
        target = ast.Name("_shown", ast.Store())
        tree.body[-1] = ast.Assign([target], last.value)
    names["_shown"] = None
    exec(compile(ast.fix_missing_locations(tree), "cell", "exec"), names)
    return names["_shown"]


def test_outputs_and_counts_are_stripped():
    notebook = json.loads(NOTEBOOK.read_text())
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    ids = [cell["id"] for cell in notebook["cells"]]
    assert len(set(ids)) == len(ids)
    for cell in code_cells():
        assert cell["outputs"] == []
        assert cell["execution_count"] is None
    assert NOTEBOOK.stat().st_size < 16_000


@pytest.mark.slow
def test_every_cell_runs_in_order_and_writes_the_pictures(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_analytic_bundle(tmp_path / "bundle", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))
    first, *others = ("".join(cell["source"]) for cell in code_cells())
    names: dict = {}
    run_cell(first, names)
    assert names.keys() >= SETTINGS.keys()
    names |= SETTINGS
    shown = [run_cell(source, names) for source in others]
    pictures = [value for value in shown if isinstance(value, Image.Image)]
    assert [picture.size for picture in pictures] == [(24, 24), (72, 24), (24, 24)]
    assert all(np.asarray(picture)[..., :3].max() > 0 for picture in pictures)
    turned = np.asarray(pictures[1]).reshape(24, 3, 24, -1)
    assert not np.array_equal(turned[:, 0], turned[:, 1])
    assert "% noise with 8 light directions" in capsys.readouterr().out
    assert {"relit.png", "relit.exr"} <= {path.name for path in tmp_path.iterdir()}
