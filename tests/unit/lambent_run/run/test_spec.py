"""A run has one specification from the command line, an order, and the folder it is kept in."""

import json
import subprocess
import sys

import numpy as np
import pytest
from flashcache.errors import ConfigError
from flashcache.presets import PRESETS, tiny
from lambent_core.errors import UsageError
from lambent_core.files import write_json
from lambent_proto.v1 import worker_pb2
from lambent_relight.environment.maps import write_environment
from lambent_run.run.card_option import GreyCard
from lambent_run.run.expected import PREPARATION, expected_seconds
from lambent_run.run.folder import begin_task, finish_task
from lambent_run.run.hashes import input_hashes
from lambent_run.run.masks import WHOLE_VIEW, given_masks
from lambent_run.run.parameters import JobParameters
from lambent_run.run.prepare import export_run, has_settings, preparation_of
from lambent_run.run.spec import RunSpec, adjust, keep_run, read_run, run_record, with_kept_corrections
from PIL import Image
from support.ball_photographs import write_masks
from support.ball_views import ball_views
from support.recording_reporter import RecordingReporter


@pytest.fixture
def sky(tmp_path):
    write_environment(tmp_path / "scene" / "sky.exr", np.ones((4, 8, 3), np.float32))
    return tmp_path / "scene" / "sky.exr"


@pytest.fixture
def cut(tmp_path):
    """Return a folder of masks among the files of the capture."""
    masks = {f"v{i}": view.mask for i, view in enumerate(ball_views(3))}
    return write_masks(tmp_path / "scene" / "cut", masks)


def options(tmp_path, **changes):
    return RunSpec.from_options(tmp_path / "scene", **{"preset": "tiny", **changes})


def ordered(tmp_path, **params):
    start = worker_pb2.StartResponse(preset="tiny")
    return RunSpec.from_job(start, JobParameters.of(params), tmp_path / "scene")


def keep(tmp_path, **changes):
    keep_run(tmp_path / "run", options(tmp_path, **changes), "cpu")


def test_an_order_and_the_command_line_ask_for_the_same_run(tmp_path, sky, cut):
    from_options = options(
        tmp_path,
        overrides={"stage_one.num_rays": "64"},
        lights=("sun", "moon"),
        layout="nerf_blender",
        known_lights=[f"sun={sky}"],
        masks=cut,
    )
    from_job = ordered(
        tmp_path,
        **{"stage_one.num_rays": "64", "lights": "sun, moon", "layout": "nerf_blender"},
        known_lights="sun=sky.exr",
        masks="cut",
    )
    assert from_job == from_options
    assert from_job.given == from_options.given
    assert from_job.config.stage_one.num_rays == 64
    assert ordered(tmp_path, masks="none").masks == options(tmp_path, whole_view=True).masks == WHOLE_VIEW


@pytest.mark.parametrize(
    "params",
    [{"known_lights": "../sky.exr"}, {"known_lights": "a=/etc/sky.exr"}, {"masks": "../cut"}],
    ids=str,
)
def test_files_of_an_order_outside_its_capture_are_refused(tmp_path, params):
    with pytest.raises(ConfigError, match="outside the capture"):
        ordered(tmp_path, **params)


def test_an_order_with_an_unknown_preset_or_setting_is_a_config_error(tmp_path):
    with pytest.raises(ConfigError):
        ordered(tmp_path, **{"no.such": "1"})
    with pytest.raises(ConfigError):
        RunSpec.from_job(worker_pb2.StartResponse(preset="huge"), JobParameters(), tmp_path)


def test_a_run_is_read_as_it_was_kept_with_its_files(tmp_path, sky, cut):
    spec = options(
        tmp_path, preset="paper_tensoir:hotdog", seed=3, lights=("a", "b"), known_lights=[str(sky)], masks=cut
    )
    keep_run(tmp_path / "run", spec, "cuda:1")
    found, device = read_run(tmp_path / "run")
    assert (found, found.scene, found.preset, device) == (
        spec,
        tmp_path / "scene",
        "paper_tensoir:hotdog",
        "cuda:1",
    )
    (name,) = found.known_lights.values()
    assert (tmp_path / "run" / "known_lights" / name).read_bytes() == sky.read_bytes()
    kept = given_masks(tmp_path / "run", found.masks)
    assert sorted(path.name for path in kept.iterdir()) == ["v0.png", "v1.png", "v2.png"]
    assert json.loads((tmp_path / "run" / "run.json").read_text())["versions"]["lambent"]


def test_a_moved_scene_or_another_device_is_the_same_run(tmp_path):
    keep(tmp_path)
    moved = RunSpec.from_options(tmp_path / "moved", preset="tiny")
    keep_run(tmp_path / "run", moved, "cuda")
    assert moved == options(tmp_path)


@pytest.mark.parametrize(
    ("changes", "named"),
    [({"seed": 1}, "seed"), ({"lights": ("a",)}, "lights"), ({"overrides": {"max_side": "32"}}, "config")],
)
def test_other_settings_for_a_folder_in_use_are_refused_and_named(tmp_path, changes, named):
    keep(tmp_path)
    begin_task(tmp_path / "run", "cache", "inputs")
    with pytest.raises(UsageError, match=rf"run\.other_settings.*another {named};"):
        keep(tmp_path, **changes)


def test_a_run_of_another_release_is_not_trained_further_but_read(tmp_path):
    keep(tmp_path)
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    del record["config"]["stage_two"]["points_per_ray"]
    (tmp_path / "run" / "run.json").write_text(json.dumps(record))
    with pytest.raises(UsageError, match=r"run\.version.*another folder.*evaluate"):
        keep(tmp_path)
    assert read_run(tmp_path / "run")[0].config == PRESETS["tiny"]()


def test_another_environment_is_another_run_and_the_same_one_elsewhere_is_not(tmp_path, sky):
    keep(tmp_path, known_lights=[str(sky)])
    keep(tmp_path, known_lights=[str(sky.rename(tmp_path / "moved.exr"))])
    write_environment(sky, np.full((4, 8, 3), 2.0, np.float32))
    with pytest.raises(UsageError, match=r"run\.other_settings.*another known_lights;"):
        keep(tmp_path, known_lights=[str(sky)])


def test_masks_may_be_others_until_a_capture_was_read_with_them(tmp_path, cut):
    keep(tmp_path, masks=cut)
    (cut / "v2.png").unlink()
    keep(tmp_path, masks=cut)
    kept = given_masks(tmp_path / "run", read_run(tmp_path / "run")[0].masks)
    assert sorted(path.name for path in kept.iterdir()) == ["v0.png", "v1.png"]
    begin_task(tmp_path / "run", "masks", "inputs")
    finish_task(tmp_path / "run", "masks", "inputs")
    with pytest.raises(UsageError, match=r"run\.other_settings.*another masks;"):
        keep(tmp_path)


STROKE = {"frame": "a", "label": "background", "stroke": [[1, 2], [3, 4]], "radius": 2}


def corrected(tmp_path, *entries):
    path = tmp_path / "given.json"
    path.write_text(json.dumps({"version": 1, "corrections": entries}))
    return path


def test_corrections_are_the_same_from_an_order_the_command_line_and_the_folder(tmp_path):
    path = corrected(tmp_path, STROKE)
    spec = options(tmp_path, corrections=path)
    assert spec == ordered(tmp_path, corrections=path.read_text())
    assert spec != options(tmp_path)
    keep_run(tmp_path / "run", spec, "cpu")
    path.unlink()
    assert read_run(tmp_path / "run")[0] == spec
    assert json.loads((tmp_path / "run" / "corrections.json").read_text())["corrections"] == [STROKE]
    assert with_kept_corrections(options(tmp_path), tmp_path / "run") == spec
    assert not with_kept_corrections(options(tmp_path, whole_view=True), tmp_path / "run").corrections


def test_corrections_of_masks_that_were_given_are_refused(tmp_path, cut):
    for others in ({"masks": cut}, {"whole_view": True}):
        with pytest.raises(UsageError, match=r"config\.corrections_unused"):
            options(tmp_path, corrections=corrected(tmp_path, STROKE), **others)


def test_a_prepared_run_takes_any_preset_and_corrections_until_its_training_begins(tmp_path):
    run = tmp_path / "run"
    keep(tmp_path)
    for task in ("ingest", "masks"):
        begin_task(run, task, "inputs")
        finish_task(run, task, "inputs")
    keep(tmp_path, preset="fast", corrections=corrected(tmp_path, STROKE))
    found = read_run(run)[0]
    assert (found.preset, len(found.corrections)) == ("fast", 1)
    keep(tmp_path, preset="fast")
    assert not read_run(run)[0].corrections
    assert not (run / "corrections.json").exists()
    begin_task(run, "cache", "inputs")
    keep(tmp_path, preset="fast")
    with pytest.raises(UsageError, match=r"run\.other_settings.*other corrections of its masks;.*-o"):
        keep(tmp_path, preset="fast", corrections=corrected(tmp_path, STROKE))
    with pytest.raises(UsageError, match=r"run\.other_settings.*another preset, config;"):
        keep(tmp_path)


def test_a_run_that_is_only_prepared_has_no_settings_until_its_training_is_asked_for(tmp_path):
    run, scene = tmp_path / "run", tmp_path / "scene"
    prepared = preparation_of(scene, run)
    assert prepared.config is None
    assert input_hashes(prepared).keys() == {"ingest", "masks"}
    assert expected_seconds(prepared.config, 2).keys() == set(PREPARATION)
    keep_run(run, prepared, "cpu")
    assert run_record(run)["config"] is None
    assert not has_settings(run)
    assert read_run(run)[0] == preparation_of(scene, run) == prepared
    keep_run(run, preparation_of(scene, run), "cpu")
    keep(tmp_path)
    assert has_settings(run)
    assert preparation_of(scene, run).config == tiny()
    hashes = input_hashes(options(tmp_path))
    assert {name: hashes[name] for name in ("ingest", "masks")} == input_hashes(prepared)


def test_a_run_that_is_only_prepared_has_neither_bundle_nor_trained_model(tmp_path):
    run = tmp_path / "run"
    keep_run(run, preparation_of(tmp_path / "scene", run), "cpu")
    with pytest.raises(UsageError, match=r"run\."):
        export_run(run, tmp_path / "bundle", RecordingReporter())
    assert not (tmp_path / "bundle").exists()


def test_photographs_are_prepared_without_torch():
    """The modules of the tasks before the training, in an interpreter that cannot import torch."""
    code = """
import sys
sys.modules["torch"] = None
from lambent_run.run import pipeline, prepare
from lambent_run.run.tasks import cameras, ingest, masks
prepare.check_device("cpu")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"schema_version": 1}', "{"])
def test_a_folder_without_a_run_is_a_usage_error(tmp_path, text):
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(UsageError, match=r"run\.not_found"):
        read_run(tmp_path)


def test_a_run_of_another_major_version_is_refused(tmp_path):
    keep(tmp_path)
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    write_json(tmp_path / "run" / "run.json", {**record, "schema_version": "2.0"})
    with pytest.raises(UsageError, match=r"run\.version"):
        read_run(tmp_path / "run")


def test_settings_on_the_command_line_change_the_preset(tmp_path):
    assert options(tmp_path, overrides={"stage_one.num_steps": "7"}).config.stage_one.num_steps == 7
    assert options(tmp_path, preset="paper_tensoir:hotdog").config.stage_one.distortion_weight == 0.01
    with pytest.raises(UsageError, match=r"config\.preset_unknown.*fast"):
        options(tmp_path, preset="fastest")
    with pytest.raises(UsageError, match=r"config\.preset_unknown.*armadillo"):
        options(tmp_path, preset="paper_tensoir:cat")
    with pytest.raises(ConfigError, match="wings"):
        options(tmp_path, overrides={"stage_one.wings": "2"})


def adjusted(**stages):
    stages = {name: worker_pb2.StageAdjustments(**own) for name, own in stages.items()}
    return adjust(PRESETS["tiny"](), worker_pb2.Adjustments(stages=stages))


def test_an_adjustment_changes_its_own_stage_and_those_of_both_hold_together():
    config = PRESETS["tiny"]()
    assert adjusted() == adjusted(evaluate={"ray_chunk": 0.5}) == config
    slower = adjusted(joint={"ray_chunk": 0.5, "learning_rate": 0.5})
    assert slower.stage_one == config.stage_one
    assert slower.stage_two.num_rays == config.stage_two.num_rays // 2
    assert slower.stage_two.material_rates.grid == config.stage_two.material_rates.grid / 2
    assert slower.stage_two.gloss_rates.network == config.stage_two.gloss_rates.network / 2
    assert slower.stage_two.environment_rate == config.stage_two.environment_rate / 2
    both = adjusted(cache={"ray_chunk": 0.5}, joint={"learning_rate": 0.5})
    assert both.stage_one.num_rays == config.stage_one.num_rays // 2
    assert both.stage_one.rates == config.stage_one.rates
    assert both.stage_two.num_rays == config.stage_two.num_rays
    assert both.stage_two.cache_rates.network == config.stage_two.cache_rates.network / 2


def test_what_the_light_stands_still_with_is_kept_and_can_be_ordered(tmp_path):
    (tmp_path / "scene").mkdir()
    wanted = options(tmp_path, light_fixed_to="camera")
    assert ordered(tmp_path, light_fixed_to="camera") == wanted != options(tmp_path)
    keep(tmp_path, light_fixed_to="camera")
    assert read_run(tmp_path / "run")[0] == wanted
    with pytest.raises(UsageError, match=r"another light_fixed_to"):
        keep(tmp_path)
    with pytest.raises(UsageError, match=r"light\.fixed_to_unknown"):
        ordered(tmp_path, light_fixed_to="flash")


CARD = "a.png:3,4,10,8:0.5"
POLISHED = {"overrides": {"polish": "on"}}


@pytest.fixture
def photographed(tmp_path):
    """Make the capture one with a photograph."""
    (tmp_path / "scene").mkdir()
    Image.fromarray(np.zeros((30, 40, 3), np.uint8)).save(tmp_path / "scene" / "a.png")


@pytest.mark.usefixtures("photographed")
def test_a_grey_card_is_the_same_from_an_order_the_command_line_and_the_folder(tmp_path):
    spec = options(tmp_path, grey_card=CARD, **POLISHED)
    assert spec.grey_card == GreyCard("a.png", (3.0, 4.0, 10.0, 8.0), 0.5)
    assert spec == ordered(tmp_path, grey_card=CARD, polish="on") != options(tmp_path, **POLISHED)
    keep_run(tmp_path / "run", spec, "cpu")
    assert read_run(tmp_path / "run")[0] == spec


@pytest.mark.usefixtures("photographed")
def test_a_grey_card_may_come_after_the_training_and_only_the_polish_is_done_again(tmp_path):
    keep(tmp_path, **POLISHED)
    before = input_hashes(options(tmp_path, **POLISHED))
    for task in ("masks", "cache", "joint", "polish"):
        begin_task(tmp_path / "run", task, before[task])
        finish_task(tmp_path / "run", task, before[task])
    keep(tmp_path, grey_card=CARD, **POLISHED)
    with_card = read_run(tmp_path / "run")[0]
    assert with_card.grey_card is not None
    after = input_hashes(with_card)
    assert {name for name in before if before[name] != after[name]} == {"polish", "evaluate", "export"}
    other = input_hashes(options(tmp_path, grey_card="a.png:3,4,10,8:0.4", **POLISHED))
    assert other["polish"] != after["polish"]


@pytest.mark.usefixtures("photographed")
@pytest.mark.parametrize(
    ("card", "changes", "code"),
    [
        (CARD, {}, "polish_off.*polish=on"),
        ("b.png:3,4,10,8", POLISHED, "photograph_missing"),
        ("a.png:3,4,100,8", POLISHED, "box_outside.*40 x 30"),
        ("a.png", POLISHED, "syntax"),
    ],
    ids=lambda value: value.split(".*")[0] if isinstance(value, str) else "",
)
def test_a_grey_card_that_cannot_be_used_is_refused_before_anything_runs(tmp_path, card, changes, code):
    with pytest.raises(UsageError, match=rf"(?s)grey_card\.{code}"):
        options(tmp_path, grey_card=card, **changes)
    with pytest.raises(UsageError, match=rf"(?s)grey_card\.{code}"):
        ordered(tmp_path, grey_card=card, **changes.get("overrides", {}))


@pytest.mark.usefixtures("photographed")
def test_a_grey_card_under_a_known_light_is_refused(tmp_path):
    write_environment(tmp_path / "scene" / "sky.exr", np.ones((4, 8, 3), np.float32))
    with pytest.raises(UsageError, match=r"grey_card\.known_light"):
        options(tmp_path, grey_card=CARD, known_lights=[str(tmp_path / "scene" / "sky.exr")], **POLISHED)
