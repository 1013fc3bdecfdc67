"""Grain is what is left of albedo where the truth is even, and tables say how sure they are."""

import numpy as np
import pytest
from PIL import Image

from benchmarks.materials import VARIANTS, grain, table, with_error

SIDE = 24


@pytest.fixture
def scene(tmp_path):
    """A view whose left half is dark and right half bright, with a border of background."""
    folder = tmp_path / "scene" / "test_000"
    folder.mkdir(parents=True)
    albedo = np.zeros((SIDE, SIDE, 4), np.uint8)
    albedo[:, : SIDE // 2, :3], albedo[:, SIDE // 2 :, :3] = 60, 180
    albedo[2:-2, 2:-2, 3] = 255
    Image.fromarray(albedo).save(folder / "albedo.png")
    return folder.parent


def predicted(tmp_path, albedo):
    folder = tmp_path / "pred" / "test_000"
    folder.mkdir(parents=True)
    np.save(folder / "albedo.npy", albedo.astype(np.float32))
    return folder.parent


def true_albedo(scene):
    return np.asarray(Image.open(scene / "test_000" / "albedo.png"), np.float64)[..., :3] / 255.0


def test_the_truth_has_no_grain_whatever_its_scale_and_edges(scene, tmp_path):
    found = grain(scene, predicted(tmp_path, 0.5 * true_albedo(scene)), [2.0] * 3)
    assert max(found.values()) == pytest.approx(0.0, abs=1e-4)


def test_noise_is_grain_and_a_slow_change_is_not(scene, tmp_path):
    noise = 0.02 * np.random.default_rng(0).standard_normal((SIDE, SIDE, 3))
    encoded = true_albedo(scene) ** (1.0 / 2.2)
    found = grain(scene, predicted(tmp_path / "a", np.clip(encoded + noise, 0.0, 1.0) ** 2.2), [1.0] * 3)
    assert found["grain, rms"] == pytest.approx(0.02 * np.sqrt(24 / 25), rel=0.15)
    assert found["grain, median"] == pytest.approx(0.6745 * found["grain, rms"], rel=0.15)
    ramp = np.linspace(-0.1, 0.1, SIDE)[:, None, None]
    slow = grain(scene, predicted(tmp_path / "b", (encoded + ramp) ** 2.2), [1.0] * 3)
    assert slow["grain, rms"] < 0.1 * found["grain, rms"]


def test_a_table_has_means_errors_and_the_change_of_pairs():
    assert with_error([1.0]) == "1.000"
    assert with_error([20.0, 22.0]) == "21.00 +- 1.00"
    before, after = [{"relit [dB]": 20.0}, {"relit [dB]": 22.0}], [{"relit [dB]": 21.0}, {"relit [dB]": 23.0}]
    text = table({"ball": dict(zip(VARIANTS, (before, after), strict=True))})
    assert "| ball | relit [dB] | 21.00 +- 1.00 | 22.00 +- 1.00 | 1.000 +- 0.000 |" in text
