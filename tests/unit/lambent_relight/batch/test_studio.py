"""Pictures rendered anew, and those made from the kept linear picture; the files are the same."""

import shutil

import numpy as np
import pytest
from lambent_relight import Renderer, write_environment
from lambent_relight.batch import plan as planning
from lambent_relight.batch.journal import open_journal
from lambent_relight.batch.plan import make_plan
from lambent_relight.batch.reading import read_manifest
from lambent_relight.batch.run import run_batch
from support.small_batch import ONE_PICTURE, write_inputs

SETTINGS = ONE_PICTURE["settings"]


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a bundle of one grey ball and two maps."""
    return write_inputs(tmp_path)


@pytest.fixture
def rendered(monkeypatch):
    """Return the maps' mean radiance of every picture that was rendered."""
    found, render = [], Renderer.render

    def counted(self, camera, environment, *given, **more):
        found.append(float(environment.radiance.mean()))
        return render(self, camera, environment, *given, **more)

    monkeypatch.setattr(Renderer, "render", counted)
    return found


def made(folder, out="out", **changes):
    """Make a batch and return its files' bytes."""
    manifest = read_manifest({**ONE_PICTURE, **changes}, folder)
    files = manifest.files.model_copy(update={"linear": True})
    with open_journal(folder / out) as journal:
        results = list(run_batch(make_plan(manifest), files, journal, strict=True))
        assert all(result.record.bounces == "one" for result in results)
        shown = [made for result in results for made in result.record.files.values()]
        return {
            each.path: (folder / out / each.path).read_bytes() for each in shown if "npz" not in each.path
        }


@pytest.mark.parametrize(
    "change",
    [{"exposure_ev": 1.5}, {"tone_mapping": "agx"}, {"background": "white"}, {"background": "environment"}],
)
def test_how_a_picture_is_shown_renders_nothing_and_changes_no_byte_of_what_comes_out(
    folder, rendered, change
):
    settings = {**SETTINGS, **change}
    before = made(folder)
    assert len(rendered) == 1
    shown = made(folder, settings=settings)
    assert len(rendered) == 1
    assert shown.keys() == before.keys()
    assert shown != before
    assert made(folder, "anew", settings=settings) == shown
    assert made(folder) == before, "and back again"
    assert len(rendered) == 2


def test_balls_in_the_corner_are_drawn_over_the_kept_picture(folder, rendered):
    manifest = read_manifest({**ONE_PICTURE, "cameras": [{"turntable": 1, "size": 32}]}, folder)
    found = []
    for probes in (False, True):
        files = manifest.files.model_copy(update={"linear": True, "probes": probes})
        with open_journal(folder / "out") as journal:
            (result,) = run_batch(make_plan(manifest), files, journal, strict=True)
        found.append((folder / "out" / result.record.files["png"].path).read_bytes())
    assert found[0] != found[1]
    assert len(rendered) == 1


def test_another_map_renders_its_own_pictures_only(folder, rendered):
    lights = {"environments": ["sky.exr", "lamp.exr"]}
    made(folder, **lights)
    rendered.clear()
    write_environment(folder / "lamp.exr", np.full((8, 16, 3), 5.0, np.float32))
    made(folder, **lights)
    assert rendered == [pytest.approx(5.0, rel=1e-3)]


@pytest.mark.parametrize("change", ["renderer", "bundle", "exr", "linear"])
def test_what_can_no_longer_be_trusted_is_rendered_again(folder, rendered, monkeypatch, change):
    """Where only a screen's exposure changed, but the EXR or the linear picture is gone, too."""
    made(folder)
    if change == "renderer":
        monkeypatch.setattr(planning, "renderer_digest", lambda: "3" * 64)
    elif change == "bundle":
        path = folder / "ball" / "manifest.json"
        path.write_text(path.read_text() + " ")
    elif change == "exr":
        next((folder / "out").rglob("*.exr")).write_bytes(b"scribbled over")
    else:
        shutil.rmtree(folder / "out" / ".linear")
    made(folder, settings={**SETTINGS, "background": "white"})
    assert len(rendered) == 2
