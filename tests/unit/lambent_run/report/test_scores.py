"""Figures in our reports are the ones the reference script prints for the same predictions."""

import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.lights import select_lights
from lambent_capture.loading.load import load_scene
from lambent_core.files import write_json
from lambent_core.scene import evenly_spaced
from lambent_run.report.predictions import save_array
from lambent_run.report.scores import Ruling, albedo_ratios, object_mask, score
from support.captures import REFERENCES
from support.predictions import reference_evaluation, write_predictions

FOLDER = REFERENCES / "scenes" / "tensoir_synthetic"


@pytest.fixture(scope="module")
def scored(tmp_path_factory):
    """Return our figures and the reference's for the same noisy predictions."""
    out = tmp_path_factory.mktemp("scores")
    manifest = select_lights(describe_scene(FOLDER), ("venice_sunset_000", "venice_sunset_120"))
    scene = load_scene(FOLDER, manifest, max_side=1000)
    write_predictions(out, scene, scene.test)
    write_json(_noise(out) / "test_000.json", {"physical/venice_sunset_000": 0.25})
    ours = figures(out, scene)
    return ours, reference_evaluation().evaluate(FOLDER, out / "pred"), out, scene


def figures(out, scene, **rules):
    ruling = Ruling.of(scene, held_out=True, **rules)
    return {row.name: row for row in score(out, scene, scene.test, ruling).as_metrics()}


def _noise(out):
    (out / "noise").mkdir()
    return out / "noise"


def test_every_shared_figure_agrees(scored):
    ours, reference, _, _ = scored
    shared = {name for name in ours if name in reference}
    assert len(shared) >= 20
    for name in shared:
        tolerance = 0.005 if ours[name].unit in ("dB", "deg") else 1e-4
        assert ours[name].value == pytest.approx(reference[name], abs=tolerance), name


def test_no_figure_of_the_reference_is_missing(scored):
    ours, reference, _, _ = scored
    figures = {name for name in reference if "/" in name}
    assert figures <= set(ours)


def test_the_albedo_ratio_agrees(scored):
    _, reference, out, scene = scored
    ratios = albedo_ratios(out, scene.test)
    assert ratios is not None
    np.testing.assert_allclose(ratios[0], reference["albedo_ratio"], rtol=1e-3)


def test_cache_and_direct_pictures_are_scored_apart(scored):
    ours, _, _, _ = scored
    assert ours["nvs_cache/psnr"].value > ours["nvs/psnr"].value + 3.0
    assert ours["relight_direct/psnr"].value > ours["relight/psnr"].value + 3.0
    assert ours["relight_unscaled/psnr"].value == pytest.approx(ours["relight/psnr"].value)


def test_figures_have_units_and_a_standard_error_over_views(scored):
    ours, _, _, _ = scored
    assert ours["nvs/psnr"].unit == "dB"
    assert ours["normal/mae_all"].unit == "deg"
    assert ours["nvs/ssim"].unit == "1"
    assert 0.0 < ours["albedo_rgb_ratio/psnr_gamma"].standard_error < 1.0


def test_distance_is_measured_on_the_object_only(scored):
    ours, _, _, _ = scored
    assert ours["distance/mean_abs"].value == pytest.approx(0.25, abs=1e-6)


def test_the_noise_of_monte_carlo_pictures_is_reported(scored):
    ours, _, _, _ = scored
    assert ours["nvs/venice_sunset_000/monte_carlo_standard_error"].value == 0.25


def test_the_noise_ceiling_is_the_psnr_that_noise_alone_leaves(scored, tmp_path):
    _, _, _, scene = scored
    generator = np.random.default_rng(1)
    for view in scene.test:
        rgba = np.full((*view.images[scene.lights[0]].shape[:2], 4), 0.5)
        rgba[..., 3] = 1.0
        save_array(tmp_path / "pred" / view.name / f"rgba_{scene.lights[0]}.npy", rgba)
        linear_error = np.full((*rgba.shape[:2], 3), 0.01)
        save_array(tmp_path / "pred" / view.name / f"rgba_{scene.lights[0]}_stderr.npy", linear_error)
    level = ((0.5 + 0.055) / 1.055) ** 2.4
    noisy = level + 0.01 * generator.standard_normal(200_000)
    encoded_error = np.std(1.055 * noisy ** (1 / 2.4) - 0.055)
    found = figures(tmp_path, scene)["nvs/noise_ceiling"]
    assert found.value == pytest.approx(-20.0 * np.log10(encoded_error), abs=0.1)
    assert found.unit == "dB"


class Difference:
    """A distance that can be worked out by hand."""

    name = "vgg"

    def distance(self, first, second):
        return float(np.abs(first - second).mean())


def test_lpips_is_in_every_group_where_weights_are_given(scored):
    _, _, out, scene = scored
    found = figures(out, scene, lpips=Difference())
    for group in (
        "nvs",
        "relight",
        "relight_direct",
        "nvs_cache",
        "albedo_rgb_ratio",
        "albedo_least_squares",
    ):
        assert found[f"{group}/lpips_vgg"].value > 0.0
    assert "nvs/lpips_vgg" not in scored[0]


def test_on_openillumination_a_run_in_several_lights_counts_for_relighting_only(scored):
    _, _, out, scene = scored
    found = figures(out, scene, dataset="openillumination")
    assert "relight/psnr" in found
    assert "nvs/psnr" not in found
    assert "nvs_several_lights/psnr" in found
    alone = replace(scene, lights=scene.lights[:1])
    found = figures(out, alone, dataset="openillumination")
    assert "nvs/psnr" in found
    assert "relight/psnr" not in found
    assert "relight_one_light/psnr" in found


def test_on_openillumination_nothing_outside_the_mask_counts(scored, tmp_path):
    _, _, out, scene = scored
    shutil.copytree(out, tmp_path / "out")
    for view in scene.test:
        outside = object_mask(view) == 0
        for light in scene.relight_lights:
            path = tmp_path / "out" / "pred" / view.name / f"rgba_{light}.npy"
            rgba = np.load(path)
            rgba[outside] = [1.0, 0.0, 0.0, 1.0]
            np.save(path, rgba)
    rules = {"dataset": "openillumination"}
    before, after = figures(out, scene, **rules), figures(tmp_path / "out", scene, **rules)
    assert after["relight/psnr"].value == before["relight/psnr"].value
    assert figures(tmp_path / "out", scene)["relight/psnr"].value < before["relight/psnr"].value - 1.0


def with_uncertainty(out, tmp_path, scene, change):
    """Return figures of predictions whose stated uncertainty is `change` of their actual error."""
    copied = tmp_path / "out"
    shutil.copytree(out, copied)
    ratio = albedo_ratios(out, scene.test)[0]
    generator = np.random.default_rng(2)
    for view in scene.test:
        albedo = np.load(copied / "pred" / view.name / "albedo.npy")[..., :3].astype(np.float64)
        wanted = np.clip(view.truth["albedo"][..., :3], 1e-3, 1.0)
        error = np.abs(np.log(np.clip(albedo * ratio, 1e-3, 1.0) / wanted)).mean(axis=-1)
        stated = np.zeros((*error.shape, 5))
        stated[..., 0] = change(error, generator) + 1e-6
        save_array(copied / "pred" / view.name / "uncertainty.npy", stated)
    return figures(copied, scene)


def test_an_uncertainty_in_the_order_of_the_errors_has_rank_correlation_one(scored, tmp_path):
    _, _, out, scene = scored
    found = with_uncertainty(out, tmp_path, scene, lambda error, _: error**3)
    assert found["uncertainty/albedo_rank_correlation"].value == pytest.approx(1.0)


def test_an_uncertainty_that_knows_nothing_has_rank_correlation_zero(scored, tmp_path):
    _, _, out, scene = scored
    found = with_uncertainty(out, tmp_path, scene, lambda error, generator: generator.random(error.shape))
    # Standard error of a rank correlation of n independent pairs: 1 / sqrt(n - 1), over views and pixels.
    pixels = sum(int((view.truth["albedo"][..., 3] > 0.99).sum()) for view in scene.test)
    assert abs(found["uncertainty/albedo_rank_correlation"].value) < 5.0 / (pixels - 1) ** 0.5


def test_the_calibration_is_the_size_of_errors_in_units_of_the_prediction(scored, tmp_path):
    _, _, out, scene = scored
    half, same = (
        with_uncertainty(out, tmp_path / str(size), scene, lambda error, _, s=size: np.full_like(error, s))
        for size in (0.05, 0.1)
    )
    name = "uncertainty/albedo_calibration"
    assert half[name].value == pytest.approx(2.0 * same[name].value, rel=1e-3)


def test_a_scene_without_truth_still_has_its_pictures_scored(tmp_path):
    folder = REFERENCES / "scenes" / "nerf_blender"
    scene = load_scene(folder, describe_scene(folder), max_side=32)
    write_predictions(tmp_path, scene, scene.train[:2])
    ruling = Ruling.of(scene, held_out=False)
    rows = {row.name for row in score(tmp_path, scene, scene.train[:2], ruling).as_metrics()}
    assert "training_views/psnr" in rows
    assert not any(name.startswith(("albedo", "normal")) for name in rows)


@pytest.mark.parametrize(("count", "expected"), [(0, 20), (1, 1), (3, 3), (20, 20), (50, 20)])
def test_views_are_chosen_at_equal_strides(count, expected):
    views = tuple(range(20))
    chosen = evenly_spaced(views, count)
    assert len(chosen) == expected
    assert len({b - a for a, b in pairwise(chosen)}) <= 1
