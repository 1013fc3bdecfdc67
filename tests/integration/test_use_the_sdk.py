"""The code of docs/howto/use-the-sdk.md runs as it is printed."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from lambent_relight import write_environment
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere
from support.live_server import LiveServer

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "use-the-sdk.md"


@pytest.mark.slow
def test_every_block_of_the_page_runs_in_order(tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 4
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_scene").mkdir()
    (tmp_path / "my_scene" / "transforms_train.json").write_text("{}")
    with LiveServer(tmp_path / "data") as server:
        monkeypatch.setenv("LAMBENT_DATA", str(server.data))
        monkeypatch.delenv("LAMBENT_URL", raising=False)
        names = {}
        for block in blocks[:3]:
            exec(block, names)
        assert (tmp_path / "my_bundle" / "manifest.json").is_file()
        assert "preset_unknown" in capsys.readouterr().out
    shutil.rmtree(tmp_path / "my_bundle")
    write_analytic_bundle(tmp_path / "my_bundle", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))
    write_environment(tmp_path / "sky.exr", np.ones((4, 8, 3), np.float32))
    exec(blocks[3], names)
    assert (tmp_path / "relit.png").is_file()
    assert (tmp_path / "relit.exr").is_file()
