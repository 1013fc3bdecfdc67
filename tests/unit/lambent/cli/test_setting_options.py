"""Settings as options: each is there, with its default and help, and arrives in the command."""

import pytest
import typer
from lambent.cli import relight, turntable
from lambent.cli.setting_options import takes
from lambent.errors import UsageProblemError
from lambent_core.pictures import RenderSettings


def options(function):
    """Return a command's options by name."""
    app = typer.Typer(add_completion=False)
    app.command()(function)
    return {each.name: each for each in typer.main.get_command(app).params}


@pytest.mark.parametrize(
    ("function", "own"), [(relight.relight, {}), (turntable.turntable, {"spp": 32, "background": "white"})]
)
def test_every_setting_is_an_option_with_its_default_and_help(function, own):
    found = options(function)
    for name, field in RenderSettings.model_fields.items():
        assert found[name].default == own.get(name, field.default)
        assert found[name].help.startswith(field.description)
    assert found["indirect"].secondary_opts == ["--direct-only"]


def test_what_is_chosen_arrives_and_what_cannot_be_meant_is_refused():
    arrived = []

    @takes("settings", RenderSettings, seed=4)
    def command(name: str, *, settings: RenderSettings) -> None:
        arrived.append((name, settings))

    defaults = {**RenderSettings().model_dump(), "seed": 4}
    command(name="x", **{**defaults, "antialias": 3})
    assert arrived == [("x", RenderSettings(seed=4, antialias=3))]
    with pytest.raises(
        UsageProblemError,
        match=r"--tone-mapping: one of linear, .* is expected, not 'filmic'",
    ):
        command(name="x", **{**defaults, "tone_mapping": "filmic"})
    with pytest.raises(UsageProblemError, match=r"--spp: 1 is .*; --until-stderr: 2\.0 is not from 0"):
        command(name="x", **{**defaults, "until_stderr": 2.0, "spp": 1})
