"""The uncertainty grid is interpolated exactly, survives its file, and refuses every other file."""

import io

import numpy as np
import pytest
from lambent_core.errors import BundleError
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.bundle.uncertainty import CHANNELS, PATH, UncertaintyGrid, read_uncertainty
from support.analytic_bundle import manifest_of, write_analytic_bundle, write_manifest
from support.analytic_scene import AnalyticScene, Sphere

LOW, HIGH = [-1.0, 0.0, 2.0], [1.0, 1.0, 5.0]


def grid(counts=(4, 3, 5)) -> UncertaintyGrid:
    """Return a grid whose channel c holds the value c + x + 2 y + 4 z at every centre."""
    axes = [LOW[k] + (np.arange(counts[k]) + 0.5) * (HIGH[k] - LOW[k]) / counts[k] for k in range(3)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    plane = x + 2.0 * y + 4.0 * z
    values = np.stack([plane + c for c in range(len(CHANNELS))], axis=-1)
    return UncertaintyGrid(np.array(LOW), np.array(HIGH), values.astype(np.float32))


def test_a_linear_function_is_reproduced_between_centres():
    positions = np.random.default_rng(0).uniform([-0.7, 0.2, 2.4], [0.7, 0.8, 4.6], (200, 3))
    expected = positions @ [1.0, 2.0, 4.0]
    np.testing.assert_allclose(grid().at(positions)[:, 0], expected, rtol=1e-5)
    np.testing.assert_allclose(grid().channel("metalness", positions), expected + 2.0, rtol=1e-5)


def test_positions_outside_get_the_value_of_the_nearest_centre():
    field = grid()
    np.testing.assert_allclose(field.at(np.array([-9.0, -9.0, -9.0])), field.values[0, 0, 0])
    np.testing.assert_allclose(field.at(np.array([9.0, 9.0, 9.0])), field.values[-1, -1, -1])


def test_any_shape_of_positions_keeps_its_shape():
    assert grid().at(np.zeros((3, 4, 3))).shape == (3, 4, len(CHANNELS))


def test_a_single_cell_is_a_constant():
    field = grid((1, 1, 1))
    found = field.at(np.array([[0.0, 0.5, 3.0], [1.0, 1.0, 5.0]]))
    np.testing.assert_allclose(found, np.repeat(field.values[0, 0], 2, axis=0))


def test_an_unknown_channel_names_the_known_ones():
    with pytest.raises(KeyError, match="perceptual_roughness"):
        grid().channel("normal", np.zeros(3))


def test_the_file_holds_the_grid():
    found = read_uncertainty(grid().to_bytes(), LOW, HIGH, list(CHANNELS))
    np.testing.assert_allclose(found.values, grid().values, rtol=1e-3)
    assert found.channels == CHANNELS


def npy(values) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values, allow_pickle=True)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (b"", "cannot be read"),
        (b"not an array", "cannot be read"),
        (npy(np.zeros((2, 2, 2, 5), np.float32)), "float32"),
        (npy(np.zeros((2, 2, 2, 4), np.float16)), "expected float16"),
        (npy(np.zeros((2, 2, 5), np.float16)), "expected float16"),
        (npy(np.zeros((0, 2, 2, 5), np.float16)), "cells"),
        (npy(np.zeros((300, 1, 1, 5), np.float16)), "cells"),
        (npy(np.full((2, 2, 2, 5), np.nan, np.float16)), "not finite"),
        (npy(np.zeros((2, 2, 2, 5), np.float16))[:-1], "another length"),
        (npy(np.array([{"a": 1}], dtype=object)), "expected float16"),
    ],
)
def test_every_other_file_is_refused(data, word):
    with pytest.raises(BundleError, match=word) as caught:
        read_uncertainty(data, LOW, HIGH, list(CHANNELS))
    assert caught.value.code == "bundle.uncertainty_invalid"


def test_a_box_without_a_size_is_refused():
    with pytest.raises(BundleError, match="box"):
        read_uncertainty(grid().to_bytes(), LOW, LOW, list(CHANNELS))


def test_a_header_that_asks_for_terabytes_is_refused_before_memory_is():
    huge = npy(np.zeros((2, 2, 2, 5), np.float16)).replace(b"(2, 2, 2, 5)", b"(99999999, 9, 9, 5)")
    with pytest.raises(BundleError):
        read_uncertainty(huge, LOW, HIGH, list(CHANNELS))


def test_a_bundle_says_how_sure_it_is_or_that_it_does_not_know(tmp_path):
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.5),))
    folder = write_analytic_bundle(tmp_path / "ball.relight", scene)
    assert load_bundle(folder).uncertainty() is None
    manifest = manifest_of(scene)
    stated = manifest.uncertainty
    stated.path = PATH
    stated.channels.extend(CHANNELS)
    stated.box.minimum.extend(LOW)
    stated.box.maximum.extend(HIGH)
    write_manifest(folder, manifest)
    with pytest.raises(BundleError, match=r"bundle\.file_missing"):
        load_bundle(folder).uncertainty()
    (folder / PATH).parent.mkdir()
    (folder / PATH).write_bytes(grid().to_bytes())
    write_manifest(folder, manifest)
    found = load_bundle(folder).uncertainty()
    assert found is not None
    np.testing.assert_allclose(found.values, grid().values, rtol=1e-3)
    np.testing.assert_allclose(found.low, LOW)
