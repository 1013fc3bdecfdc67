"""Runs in several lights, in one turned light and in a given one, from the capture to the trained model."""

import functools
import json

import numpy as np
import pytest
import torch
from flashcache.errors import ConfigError
from flashcache.training.checkpoint import latest_checkpoint
from lambent_core.errors import UsageError, WorkerError
from lambent_relight.environment.maps import write_environment
from lambent_run.run.folder import task_folder
from lambent_run.run.pipeline import run_pipeline
from lambent_run.run.prepare import open_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks import ingest
from lambent_run.run.tasks.training import load_trained, read_scene
from support.captures import REFERENCES
from support.recording_reporter import RecordingReporter

from benchmarks.stage_sharing import adopt_nerf_cache

pytestmark = pytest.mark.slow

SCENE = REFERENCES / "scenes" / "tensoir_synthetic"
LIGHTS = ("venice_sunset_000", "venice_sunset_120")
SMALL = {
    "max_side": "16",
    "stage_one.num_steps": "3",
    "stage_one.num_rays": "64",
    "stage_two.num_steps": "3",
    "stage_two.num_rays": "32",
    "stage_two.warmup_steps": "1",
    "stage_two.distil.num_steps": "1",
    "model.environment.known_height": "8",
}
TASKS = ("ingest", "cache", "joint")


@pytest.fixture(autouse=True, scope="module")
def checked_once():
    """Check the capture once: it is the same for all runs here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ingest, "check_capture", functools.cache(ingest.check_capture))
        yield


def trained(folder, lights, known=(), tasks=TASKS, light_fixed_to="auto", **settings):
    """Train a few steps and return the run and the model."""
    spec = RunSpec.from_options(
        SCENE,
        preset="tiny",
        lights=lights,
        overrides=SMALL | settings,
        known_lights=known,
        light_fixed_to=light_fixed_to,
    )
    reporter = RecordingReporter()
    run_pipeline(spec, folder, "cpu", reporter, tasks)
    if "joint" not in tasks:
        return spec, None
    context = open_task(folder, "joint", reporter)
    return spec, load_trained(context, read_scene(context), "joint")


@pytest.fixture
def sky(tmp_path):
    """Return the path of a map that is bright in the east."""
    image = np.full((8, 16, 3), 0.5, np.float32)
    image[:, 6:10] = 4.0
    write_environment(tmp_path / "sky.exr", image, half=False)
    return tmp_path / "sky.exr"


def test_several_lights_have_a_head_each(tmp_path):
    _, model = trained(tmp_path / "run", LIGHTS)
    assert model.domain.lights == LIGHTS
    assert (model.environment.num_lights, model.fast.num_lights) == (2, 2)
    first, second = (model.environment.image(8, light) for light in (0, 1))
    assert not torch.allclose(first, second)


def test_turned_lights_share_one_environment(tmp_path):
    _, model = trained(tmp_path / "run", LIGHTS, **{"model.environment.lights": "rotated"})
    assert model.domain.rotations_deg == (0.0, 120.0)
    assert (model.environment.num_lights, model.fast.num_lights) == (1, 2)
    # 120 degrees are a third of the columns, to the left.
    first, second = (model.environment.image(6, light) for light in (0, 1))
    torch.testing.assert_close(second, first.roll(-4, dims=1), rtol=1e-4, atol=1e-4)


def test_a_given_environment_stays_what_it_is_while_the_rest_learns(tmp_path, sky):
    _, model = trained(tmp_path / "run", LIGHTS[:1], [str(sky)])
    sky.unlink()
    expected = np.full((8, 16, 3), 0.5, np.float32)
    expected[:, 6:10] = 4.0
    np.testing.assert_allclose(model.environment.image(8).numpy(), expected, rtol=1e-4)
    folder = latest_checkpoint(task_folder(tmp_path / "run", "joint"))
    assert json.loads((folder / "state.json").read_text())["num_skipped"] == 0


def test_a_given_light_beside_a_learned_one(tmp_path, sky):
    _, model = trained(tmp_path / "run", LIGHTS, [f"{LIGHTS[1]}={sky}"])
    assert model.environment.learned == (0,)
    assert float(model.environment.image(8, 1).max()) == pytest.approx(4.0, rel=1e-4)


def test_a_file_that_could_be_any_lights_is_refused(tmp_path, sky):
    with pytest.raises(UsageError, match=r"light\.known_unnamed"):
        trained(tmp_path / "run", LIGHTS, [str(sky)])


def test_lights_without_angles_cannot_be_turned(tmp_path):
    wrong = {"model.environment.lights": "rotated", "model.environment.rotations_deg": "[10]"}
    with pytest.raises(ConfigError, match="one per light"):
        trained(tmp_path / "run", LIGHTS, **wrong)


def test_a_run_takes_over_the_nerf_cache_of_another_with_another_environment(tmp_path):
    lights = LIGHTS[:1]
    trained(tmp_path / "base", lights, tasks=TASKS[:2])
    other = {"model.environment.last_width": "8"}
    spec, _ = trained(tmp_path / "other", lights, tasks=TASKS[:1], **other)
    reporter = RecordingReporter()
    for _ in range(2):  # The second time there is nothing to do.
        adopt_nerf_cache(tmp_path / "other", tmp_path / "base", reporter)
    run_pipeline(spec, tmp_path / "other", "cpu", reporter, TASKS)
    assert {call["stage"] for call in reporter.named("step.reused")} == {"ingest", "cache"}
    base = latest_checkpoint(task_folder(tmp_path / "base", "cache"))
    taken = latest_checkpoint(task_folder(tmp_path / "other", "cache"))
    tables = [torch_tensors(folder)["nerf.density.grid.table"] for folder in (base, taken)]
    assert torch.equal(*tables)
    assert torch_tensors(taken)["environment.last.bias"].shape == (8,)


def torch_tensors(folder):
    from safetensors.torch import load_file

    return load_file(folder / "model.safetensors")


def test_a_nerf_cache_that_is_not_there_or_does_not_fit_is_refused(tmp_path):
    lights = LIGHTS[:1]
    trained(tmp_path / "run", lights, tasks=TASKS[:1])
    reporter = RecordingReporter()
    with pytest.raises(WorkerError, match=r"run\.no_stage_one"):
        adopt_nerf_cache(tmp_path / "run", tmp_path / "none", reporter)
    trained(tmp_path / "base", lights, tasks=TASKS[:2], **{"model.nerf.density.width": "16"})
    with pytest.raises(WorkerError, match=r"run\.other_shape"):
        adopt_nerf_cache(tmp_path / "run", tmp_path / "base", reporter)


def test_a_light_fixed_to_the_camera_has_a_turn_for_every_photograph(tmp_path):
    evaluated = {"evaluation.num_views": "1", "evaluation.uncertainty_points": "20"}
    tasks = (*TASKS, "evaluate")
    _, model = trained(tmp_path / "run", LIGHTS[:1], tasks=tasks, light_fixed_to="camera", **evaluated)
    manifest = json.loads((task_folder(tmp_path / "run", "ingest") / "manifest.json").read_text())
    assert manifest["light_fixed_to"] == "camera"
    assert len(model.domain.turns) == 1 + len(manifest["frames"])
    first = next(frame for frame in manifest["frames"] if "train" in frame["name"])
    pose = np.array(first["camera"]["camera_to_world"]).reshape(4, 4)
    np.testing.assert_allclose(np.array(manifest["light_frame"]).reshape(3, 3), pose[:3, :3])
    report = json.loads((task_folder(tmp_path / "run", "evaluate") / "report.json").read_text())
    assert any("with the turn that the light had" in note for note in report["notes"])


def test_several_lights_cannot_be_fixed_to_the_camera(tmp_path):
    with pytest.raises(UsageError, match=r"light\.fixed_to_several"):
        trained(tmp_path / "run", LIGHTS, light_fixed_to="camera", tasks=TASKS[:1])


CARD = f"train_000/rgba_{LIGHTS[0]}.png"


def test_a_grey_card_reaches_the_polish_and_what_became_of_it_the_user(tmp_path):
    """A model of three steps has no surface, and the user hears that the card was not used."""
    spec = RunSpec.from_options(
        SCENE,
        preset="tiny",
        lights=LIGHTS[:1],
        overrides=SMALL | {"polish": "on", "max_side": "64"},
        grey_card=f"{CARD}:52,62,24,20",
    )
    reporter = RecordingReporter()
    run_pipeline(spec, tmp_path / "run", "cpu", reporter, (*TASKS, "polish"))
    told = [finding for finding in reporter.named("finding") if finding["code"].startswith("grey_card.")]
    assert [finding["code"] for finding in told] == ["grey_card.not_used"]
    assert len(reporter.named("polish.kept")) == 1


@pytest.mark.parametrize(
    ("box", "code"), [("0,0,8,8", "grey_card.outside_mask"), ("60,64,4,4", "grey_card.box_small")]
)
def test_a_grey_card_in_the_wrong_place_is_refused_before_the_training(tmp_path, box, code):
    spec = RunSpec.from_options(
        SCENE,
        preset="tiny",
        lights=LIGHTS[:1],
        overrides=SMALL | {"polish": "on", "max_side": "32"},
        grey_card=f"{CARD}:{box}",
    )
    with pytest.raises(UsageError, match=code):
        run_pipeline(spec, tmp_path / "run", "cpu", RecordingReporter(), TASKS)
    assert not list((tmp_path / "run" / "cache").glob("step_*"))


def test_a_grey_card_under_another_light_is_refused_when_the_capture_is_read(tmp_path):
    spec = RunSpec.from_options(
        SCENE,
        preset="tiny",
        lights=LIGHTS[1:],
        overrides=SMALL | {"polish": "on"},
        grey_card=f"{CARD}:52,62,24,20",
    )
    with pytest.raises(UsageError, match=rf"grey_card\.photograph_unused.*{LIGHTS[1]}"):
        run_pipeline(spec, tmp_path / "run", "cpu", RecordingReporter(), TASKS[:1])
