import json

import pytest
import typer
from flashcache.presets import tiny
from lambent_run.commands import training as cli
from lambent_run.run.memory_plan import as_text, plan
from typer.testing import CliRunner


@pytest.mark.slow
def test_the_plan_has_the_settings_and_sizes_of_both_stages():
    found = plan(tiny(), num_lights=1, device="")
    assert list(found["stages"]) == ["cache", "joint"]
    assert found["device"] == "cpu"
    for stage in found["stages"].values():
        parts = [stage[f"{part}_bytes"] for part in ("parameters", "gradients", "moments", "activations")]
        assert min(parts) > 0
        assert sum(parts) == stage["total_bytes"]
    text = as_text(found)
    assert "preset tiny on cpu" in text
    assert str(tiny().stage_one.num_steps) in text
    assert f"{tiny().stage_two.num_steps}+{tiny().stage_two.distil.num_steps}" in text
    assert tiny().stage_two.distil.num_steps > 0


def test_a_dry_run_trains_and_writes_nothing(tmp_path):
    app = typer.Typer()
    app.command()(cli.train)
    run = tmp_path / "run"
    arguments = [str(tmp_path), "-o", str(run), "--preset", "tiny", "--dry-run", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--set", "stage_two.num_steps=7"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["stages"]["joint"]["num_steps"] == 7
    assert not run.exists()
