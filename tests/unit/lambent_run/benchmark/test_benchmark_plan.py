"""Cells are named by everything that their result depends on, and by nothing else."""

from dataclasses import replace
from pathlib import Path

import pytest
from flashcache.errors import ConfigError
from lambent_core.errors import UsageError
from lambent_run.benchmark.cell import discard_predictions
from lambent_run.benchmark.plan import CELL_FILE, GROUPS, parse_variants, plan
from lambent_run.benchmark.suite import find_environments, find_scenes
from lambent_run.report.request import EvaluationRequest
from support.captures import write_blender, write_tensoir


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("suite")
    write_tensoir(folder / "crate", lights=("sun_000", "sun_120"), relight=("city",))
    write_tensoir(folder / "lego", lights=("sunset", "snow"), relight=("city",))
    write_blender(folder / "bowl")
    (folder / "notes").mkdir()
    (folder / "envmaps" / "high_res").mkdir(parents=True)
    (folder / "envmaps" / "high_res" / "city.hdr").write_bytes(b"map")
    return folder


def cells(
    suite,
    *names,
    ablations=(),
    seeds=(0,),
    settings=None,
    preset="tiny",
    overrides=None,
    keep=True,
    **request,
):
    return plan(
        find_scenes(suite, names or ("crate",)),
        parse_variants(ablations),
        seeds,
        settings,
        preset=preset,
        overrides=overrides or {},
        evaluation=EvaluationRequest(**request),
        keep_predictions=keep,
    )


def test_scenes_are_the_folders_in_a_known_layout(suite):
    assert [scene.name for scene in find_scenes(suite, ())] == ["bowl", "crate", "lego"]
    assert [scene.name for scene in find_scenes(suite / "crate", ())] == ["crate"]
    with pytest.raises(UsageError, match=r"benchmark\.scenes_missing.*vase.*bowl, crate, lego"):
        find_scenes(suite, ("vase",))
    with pytest.raises(UsageError, match=r"benchmark\.scenes_missing"):
        find_scenes(suite / "notes", ())
    with pytest.raises(UsageError, match=r"benchmark\.suite_missing"):
        find_scenes(suite / "nothing", ())


def test_environments_are_found_at_their_usual_place(suite, tmp_path):
    assert find_environments(suite, None) == suite / "envmaps" / "high_res"
    assert find_environments(suite, tmp_path) == tmp_path
    assert find_environments(tmp_path, None) is None


def test_ablations_share_stage_one_and_differ_in_their_results(suite):
    found = cells(suite, ablations=("paper",))
    assert len(found) == len(GROUPS["paper"]) == 7
    assert len({cell.stage_one for cell in found}) == 1
    assert len({cell.inputs for cell in found}) == 7
    assert all(dict(cell.base_overrides) == {} for cell in found)


def test_an_ablation_that_changes_stage_one_gets_its_own(suite):
    full, other = cells(suite, ablations=("short:stage_one.num_steps=5",))
    assert full.stage_one != other.stage_one
    assert other.base_overrides == {"stage_one.num_steps": "5"}
    assert full.base_overrides == {}


@pytest.mark.parametrize(
    ("changes", "stage_one"),
    [
        ({"seeds": (1,)}, True),
        ({"overrides": {"stage_one.num_steps": "7"}}, True),
        ({"overrides": {"stage_two.num_steps": "7"}}, False),
        ({"num_repeats": 2}, False),
        ({"shadows": "nerf"}, False),
        ({"lpips_weights": (Path("x.pth"),)}, False),
        ({"settings": ("multi",)}, True),
    ],
)
def test_what_a_result_depends_on_changes_its_name(suite, changes, stage_one):
    (before,), (after,) = cells(suite), cells(suite, **changes)
    assert before.inputs != after.inputs
    assert (before.stage_one != after.stage_one) == stage_one


def test_the_contents_of_environment_maps_count_and_their_place_does_not(suite, tmp_path):
    first, second, third = tmp_path / "a", tmp_path / "b", tmp_path / "c"
    for folder, data in ((first, b"sky"), (second, b"sky"), (third, b"sun")):
        folder.mkdir()
        (folder / "city.hdr").write_bytes(data)
    found = [cells(suite, environments=folder)[0].inputs for folder in (first, second, third)]
    assert found[0] == found[1] != found[2]


def test_keeping_predictions_makes_no_other_result(suite):
    assert cells(suite, keep=False)[0].inputs == cells(suite)[0].inputs


def test_discarded_predictions_leave_the_report(tmp_path):
    for name in ("pred/test_000", "pred_cache/test_000", "noise"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "report.html").touch()
    discard_predictions(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["noise", "report.html"]


def test_several_lights_of_one_turned_environment_are_trained_as_such(suite):
    (turned,) = cells(suite, "crate", settings=("multi",))
    assert turned.lights == ("sun_000", "sun_120")
    assert turned.overrides == {"model.environment.lights": "rotated"}
    (separate,) = cells(suite, "lego", settings=("multi",))
    assert separate.lights == ("sunset", "snow")
    assert separate.overrides == {}


def test_a_scene_in_one_light_has_no_several(suite):
    with pytest.raises(UsageError, match=r"benchmark\.one_light.*bowl"):
        cells(suite, "bowl", settings=("multi",))


def test_openillumination_is_run_in_both_settings(suite):
    (scene,) = find_scenes(suite, ("lego",))
    objects = replace(scene, layout="openillumination", lights=("013", "011", "009", "001"))
    assert scene.settings == ("single",)
    assert objects.settings == ("single", "multi")
    assert objects.lights_of("single") == ("013",)
    assert objects.lights_of("multi") == ("013", "011", "009")


def test_a_paper_preset_takes_the_papers_settings_of_its_scene(suite):
    presets = {cell.scene: cell.preset for cell in cells(suite, "crate", "lego", preset="paper_tensoir")}
    assert presets["crate"] == "paper_tensoir"
    assert presets["lego"] in ("paper_tensoir", "paper_tensoir:lego")
    (cell,) = cells(suite, "lego", preset="tiny")
    assert cell.preset == "tiny"


def test_a_cell_survives_its_file(suite):
    (cell,) = cells(suite, lpips_weights=(Path("a.pth"), Path("b.pth")), environments=suite / "envmaps")
    assert CELL_FILE.validate_json(CELL_FILE.dump_json(cell)) == cell


def test_the_full_method_comes_first_whatever_was_asked_for():
    assert [v.name for v in parse_variants(("depth,k2",))] == ["full", "depth", "k2"]
    assert [v.name for v in parse_variants(("k2", "all"))][:2] == ["full", "k2"]
    assert parse_variants(())[0].name == "full"


@pytest.mark.parametrize("text", ["k3", "paper,nothing", ""])
def test_an_unknown_ablation_names_the_known_ones(text):
    with pytest.raises(UsageError, match=r"benchmark\.ablation_unknown.*no_sampler"):
        parse_variants((text,))


@pytest.mark.parametrize("text", ["x:", "x:stage_two.num_rays", "k2:stage_two.num_rays=1", "a b:x=1", ":x=1"])
def test_settings_of_ones_own_need_a_name_and_values(text):
    with pytest.raises(UsageError, match=r"benchmark\.ablation_syntax"):
        parse_variants((text,))


def test_settings_that_do_not_exist_are_refused_before_anything_runs(suite):
    with pytest.raises(ConfigError, match="num_raindrops"):
        cells(suite, ablations=("x:stage_two.num_raindrops=1",))
