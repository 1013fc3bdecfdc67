"""True environments are found by the light's name, turned where the name says so."""

import numpy as np
import pytest
import torch
from flashcache.caches.environment import Environment, EnvironmentConfig
from lambent_core.errors import UsageError
from lambent_relight.environment.maps import write_environment
from lambent_run.run.true_lights import read_true_lights, turned_about_z


def bright_at(column: int, columns: int = 64) -> np.ndarray:
    image = np.full((columns // 2, columns, 3), 0.5, np.float32)
    image[10, column] = 8.0
    return image


def written(folder, name, image):
    folder.mkdir(parents=True, exist_ok=True)
    write_environment(folder / name, image, half=False)


def test_a_map_belongs_to_the_light_of_its_name_and_the_first_folder_decides(tmp_path):
    written(tmp_path / "one", "sun.exr", bright_at(3))
    written(tmp_path / "two", "sun.exr", bright_at(9))
    written(tmp_path / "two", "moon.exr", bright_at(20))
    found = read_true_lights(("sun", "moon", "lamp"), [tmp_path / "one", tmp_path / "two", tmp_path / "none"])
    assert {light: int(image[10, :, 0].argmax()) for light, image in found.items()} == {"sun": 3, "moon": 20}


def test_a_name_with_an_angle_is_the_map_without_it_turned_as_lights_are(tmp_path):
    written(tmp_path, "sun.exr", bright_at(32))
    found = read_true_lights(("sun_000", "sun_90"), [tmp_path])
    assert int(found["sun_000"][10, :, 0].argmax()) == 32
    # Counter-clockwise from above is to the left: azimuth falls to the right.
    assert int(found["sun_90"][10, :, 0].argmax()) == 16
    written(tmp_path, "sun_90.exr", bright_at(5))
    assert int(read_true_lights(("sun_90",), [tmp_path])["sun_90"][10, :, 0].argmax()) == 5


def test_a_map_is_turned_as_the_environments_of_rotated_lights_are():
    torch.manual_seed(0)
    network = Environment(EnvironmentConfig(width=8, last_width=8), 2, rotations_deg=(0.0, 120.0))
    first, second = (network.image(24, light).numpy() for light in (0, 1))
    np.testing.assert_allclose(turned_about_z(first, 120.0), second, rtol=1e-4, atol=1e-5)


def test_half_a_column_is_the_mean_of_two():
    found = turned_about_z(bright_at(32).astype(float), 0.5 * 360.0 / 64)
    np.testing.assert_allclose(found[10, 31:33, 0], (8.5 / 2.0, 8.5 / 2.0))


def test_a_map_too_small_to_be_compared_is_none_and_a_broken_one_an_error(tmp_path):
    written(tmp_path, "sun.exr", np.ones((8, 16, 3), np.float32))
    assert read_true_lights(("sun",), [tmp_path]) == {}
    (tmp_path / "moon.hdr").write_bytes(b"#?RADIANCE\nbroken")
    with pytest.raises(UsageError, match=r"evaluate\.environment_unreadable"):
        read_true_lights(("moon",), [tmp_path])
