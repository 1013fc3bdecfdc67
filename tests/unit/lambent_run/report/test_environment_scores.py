"""Figures of a recovered environment move with what is wrong with it, and with nothing else."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from flashcache.geometry.directions import environment_directions
from lambent_run.report.environment_scores import COLUMNS, ROWS, compare_environments, score_environments
from lambent_run.report.table import Table
from scipy.ndimage import gaussian_filter1d
from support.evaluation_subject import subject_of
from support.lit_sphere import lit_domain, lit_sphere


def sky(rows: int = 64) -> np.ndarray:
    """Return a blue gradient with a warm sun at 40 degrees above the horizon, some columns right of +x."""
    directions = environment_directions(rows, 2 * rows, torch.float64).numpy()
    sun = np.array([0.6, -0.47, 0.643])
    lobe = np.exp(150.0 * (directions @ (sun / np.linalg.norm(sun)) - 1.0))[..., None]
    return lobe * np.array([30.0, 25.0, 18.0]) + (0.6 + 0.4 * directions[..., 2:]) * np.array([0.2, 0.3, 0.5])


SKY = sky()


def test_a_perfect_map_has_no_error():
    found = compare_environments(SKY, SKY)
    assert found.log_rmse == pytest.approx(0.0, abs=1e-12)
    assert found.log_rmse_unscaled == 0.0
    assert (found.peak_ratio, found.peak_ratio_unscaled, found.peak_angle_deg) == (1.0, 1.0, 0.0)


def test_a_factor_per_channel_moves_the_unscaled_figures_only():
    factor = np.array([2.0, 1.5, 3.0])
    found = compare_environments(SKY * factor, SKY)
    assert found.log_rmse == pytest.approx(0.0, abs=1e-6)
    assert found.peak_ratio == pytest.approx(1.0)
    assert found.peak_angle_deg == 0.0
    np.testing.assert_allclose(found.factor, 1.0 / factor, rtol=1e-9)
    assert found.log_rmse_unscaled == pytest.approx(np.sqrt(np.square(np.log(factor)).mean()))
    assert found.peak_ratio_unscaled > 1.3


def test_a_turned_map_has_its_peak_elsewhere_and_as_high():
    columns = 16  # of 128: 45 degrees of azimuth
    found = compare_environments(np.roll(SKY, columns, axis=1), SKY)
    assert found.peak_ratio == pytest.approx(1.0)
    bright = np.argwhere(SKY.sum(axis=-1) == SKY.sum(axis=-1).max())[0]
    elevation = 0.5 * np.pi - np.pi * (2 * (bright[0] // 2) + 1.0) / 64
    cosine = np.sin(elevation) ** 2 + np.cos(elevation) ** 2 * np.cos(np.radians(45.0))
    assert found.peak_angle_deg == pytest.approx(np.degrees(np.arccos(cosine)), abs=0.01)
    assert found.log_rmse > 0.3


def test_a_blurred_map_has_a_lower_peak_in_the_same_place():
    blurred = gaussian_filter1d(gaussian_filter1d(SKY, 6, axis=1, mode="wrap"), 6, axis=0)
    found = compare_environments(blurred, SKY)
    assert found.peak_ratio < 0.5
    assert found.peak_ratio_unscaled < 0.5
    assert found.peak_angle_deg is not None
    assert found.peak_angle_deg < 12.0
    assert 0.1 < found.log_rmse <= found.log_rmse_unscaled


def test_directions_count_by_solid_angle_and_not_by_pixels():
    """The uppermost row of 32 is 1.6 % of the pixels' rows, and 0.24 % of the sphere."""
    wrong = SKY.copy()
    wrong[:2] *= np.e
    found = compare_environments(wrong, SKY)
    share = 0.5 * (1.0 - np.cos(np.pi / ROWS))
    assert found.log_rmse_unscaled == pytest.approx(np.sqrt(share), rel=1e-3)
    assert found.log_rmse == pytest.approx(np.sqrt(share * (1.0 - share)), rel=1e-3)


def test_darkness_below_a_hundredth_of_the_mean_is_all_one():
    dark, darker = np.ones((ROWS, COLUMNS, 3)), np.ones((ROWS, COLUMNS, 3))
    dark[ROWS // 2 :], darker[ROWS // 2 :] = 1e-3, 1e-6
    assert compare_environments(darker, dark).log_rmse == pytest.approx(0.0, abs=2e-3)
    darker[ROWS // 2 :] = 0.02
    apart = np.log(0.02 / (0.01 * 0.5005))
    assert compare_environments(darker, dark).log_rmse_unscaled == pytest.approx(apart / 2**0.5, rel=1e-3)


def test_any_resolution_can_be_compared_and_an_even_light_has_no_direction():
    found = compare_environments(sky(128), sky(64))
    assert found.log_rmse < 0.01
    even = compare_environments(SKY, np.ones((ROWS, COLUMNS, 3)))
    assert even.peak_angle_deg is None
    assert even.peak_ratio > 5.0


class Lights:
    """A model that holds given environments."""

    def __init__(self, images, lights, **domain):
        scene = replace(lit_sphere(2, side=4), lights=lights)
        self.domain = replace(lit_domain(scene), **domain)
        self.environment = SimpleNamespace(image=lambda height, light: torch.from_numpy(images[light]))


def scored(tmp_path: Path, images, lights, true_lights, **domain) -> dict[str, float]:
    scene = replace(lit_sphere(2, side=4), lights=lights)
    model, table = Lights(images, lights, **domain), Table()
    score_environments(table, subject_of(model, scene, out=tmp_path, true_lights=true_lights))
    return {row.name: row.value for row in table.as_metrics()}


def test_every_learned_light_with_a_true_map_has_figures_and_both_maps_are_kept(tmp_path):
    truth = {"a": SKY, "b": SKY}
    found = scored(tmp_path, [SKY, SKY * np.e], ("a", "b"), truth)
    assert found["environment/a/log_rmse_unscaled"] == 0.0
    assert found["environment/b/log_rmse_unscaled"] == pytest.approx(1.0)
    assert found["environment/log_rmse_unscaled"] == pytest.approx(0.5)
    assert found["environment/peak_angle"] == 0.0
    kept = np.load(tmp_path / "environments" / "b.npy")
    assert kept.shape == (ROWS, COLUMNS, 3)
    np.testing.assert_allclose(kept, np.e * np.load(tmp_path / "environments" / "b_true.npy"), rtol=1e-5)


def test_a_light_that_was_given_or_whose_truth_is_unknown_is_not_scored(tmp_path):
    images = [SKY, SKY * 2.0]
    found = scored(tmp_path, images, ("a", "b"), {"a": SKY, "b": SKY}, known_lights=("b",))
    assert {name for name in found if name.endswith("log_rmse")} == {
        "environment/log_rmse",
        "environment/a/log_rmse",
    }
    assert scored(tmp_path, images, ("a", "b"), {}) == {}
    alone = scored(tmp_path, images[:1], ("a",), {"a": SKY})
    assert set(alone) >= {"environment/log_rmse", "environment/peak_ratio"}
    assert not any(name.startswith("environment/a") for name in alone)


def test_lights_that_are_one_turned_environment_are_scored_once_and_not_if_it_was_given(tmp_path):
    images, truth = [SKY, SKY * 5.0], {"a": SKY, "b": SKY}
    found = scored(tmp_path, images, ("a", "b"), truth, rotations_deg=(0.0, 90.0))
    assert found["environment/log_rmse_unscaled"] == 0.0
    assert "environment/a/log_rmse" not in found
    turned = {"rotations_deg": (0.0, 90.0), "known_lights": ("b",)}
    assert scored(tmp_path, images, ("a", "b"), truth, **turned) == {}
