"""The demo's figures against the reference evaluation, which shares no code with them."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
from lambent import truth
from PIL import Image

REFERENCE = Path(__file__).parents[1] / "references" / "evaluate.py"


@pytest.fixture(scope="module")
def reference():
    """Return the reference evaluation as a module."""
    spec = importlib.util.spec_from_file_location("reference_evaluate", REFERENCE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def scene(tmp_path):
    """Return a folder of three random views in TensoIR-synthetic's layout, two of them for testing."""
    generator = np.random.default_rng(3)
    folder = tmp_path / "scene"
    for number, name in enumerate(("train_000", "test_000", "test_001")):
        view = folder / name
        view.mkdir(parents=True)
        alpha = np.clip(generator.uniform(-1.0, 2.0, (14, 16, 1)), 0.0, 1.0)
        for stem in ("albedo", "normal", "rgba_sun_000", "rgba_moon"):
            rgba = np.concatenate([generator.uniform(0.05, 1.0, (14, 16, 3)), alpha], axis=-1)
            Image.fromarray(np.round(255 * rgba).astype(np.uint8)).save(view / f"{stem}.png")
        for stem in ("roughness", "metallic"):
            values = generator.uniform(0.0, 1.0, (14, 16))
            Image.fromarray(np.round(255 * values).astype(np.uint8)).save(view / f"{stem}.png")
        pose = np.eye(4)
        pose[2, 3] = 3.0 + number
        words = ",".join(map(str, pose.ravel()))
        metadata = {"imw": 16, "imh": 14, "cam_angle_x": 0.6, "cam_transform_mat": words}
        (view / "metadata.json").write_text(json.dumps(metadata))
    info = {"scene": "random", "train_env": "sun", "rotations": ["000"], "test_envs": ["moon"]}
    (folder / "scene.json").write_text(json.dumps(info))
    return folder


def test_albedo_normals_and_pictures_get_the_reference_figures(reference, scene, tmp_path):
    generator = np.random.default_rng(5)
    views = [truth.read_view(scene / name, ("sun_000", "moon")) for name in ("test_000", "test_001")]
    albedo, normals, relit = [], [], []
    maps: dict[str, list] = {"roughness": [], "metallic": []}
    for view in views:
        folder = tmp_path / "pred" / view.name
        folder.mkdir(parents=True)
        coverage = generator.uniform(0.0, 1.0, (14, 16, 1))
        colour = generator.uniform(0.0, 1.0, (14, 16, 3))
        np.save(folder / "albedo.npy", np.concatenate([colour, coverage], axis=-1))
        albedo.append(colour * coverage + 1.0 - coverage)
        normal = generator.normal(size=(14, 16, 3))
        normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        np.save(folder / "normal.npy", normal)
        normals.append(normal)
        picture = generator.uniform(0.0, 1.0, (14, 16, 3))
        np.save(folder / "rgba_moon.npy", picture)
        relit.append(picture)
        for stem, found in maps.items():
            found.append(generator.uniform(0.0, 1.0, (14, 16)))
            np.save(folder / f"{stem}.npy", found[-1])
    expected = reference.evaluate(scene, tmp_path / "pred")
    ratio = truth.albedo_ratio(albedo, views)
    np.testing.assert_allclose(ratio, expected["albedo_ratio"], rtol=1e-12)
    assert truth.albedo_psnr(albedo, ratio, views) == pytest.approx(expected["albedo_rgb_ratio/psnr_gamma"])
    errors = [truth.normal_error_deg(n, v) for n, v in zip(normals, views, strict=True)]
    assert np.mean(errors) == pytest.approx(expected["normal/mae_mask"])
    for stem, name in (("roughness", "roughness"), ("metallic", "metalness")):
        found = [truth.rmse(m, getattr(v, name), v.mask) for m, v in zip(maps[stem], views, strict=True)]
        assert np.mean(found) == pytest.approx(expected[f"{stem}/rmse"])
    pairs = zip(relit, views, strict=True)
    assert np.mean([truth.psnr(p, v.pictures_srgb["moon"]) for p, v in pairs]) == pytest.approx(
        expected["rgb/moon/psnr"]
    )


def test_the_nearest_photograph_is_the_one_of_the_closest_camera(scene):
    view = truth.read_view(scene / "test_000", ("sun_000",))
    other = scene / "train_001"
    (scene / "test_001").rename(other)
    found = truth.nearest_photograph(scene, view, "sun_000")
    closest = truth.read_view(scene / "train_000", ("sun_000",))
    np.testing.assert_array_equal(found, closest.pictures_srgb["sun_000"])


def test_the_camera_looks_as_the_layout_says(scene):
    camera = truth.read_camera(scene / "train_000")
    assert camera.focal_x == pytest.approx(8.0 / np.tan(0.3))
    assert (camera.centre_x, camera.centre_y) == (8.0, 7.0)
    np.testing.assert_array_equal(camera.camera_to_world[:3, 3], [0.0, 0.0, 3.0])
