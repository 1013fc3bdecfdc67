"""The error of float16 tables, and its measurement."""

import numpy as np
import pytest
import torch
from flashcache.export.stored_grids import exported_grids
from lambent_asset.textures.half_tables import fits_half, rounding_of, with_half_tables
from support.sphere_model import sphere_model


@pytest.mark.parametrize("gloss_grid", [False, True])
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_only_exported_tables_are_rounded_as_readers_see_them_and_the_model_itself_is_not(scale, gloss_grid):
    model = sphere_model(output_scale=scale, gloss_grid=gloss_grid)
    before = {name: value.clone() for name, value in model.named_parameters()}
    rounded = dict(with_half_tables(model).named_parameters())
    tables = {f"{name}.table" for name in exported_grids(model)}
    # It is stored as further levels of the other.
    tables |= {"materials.gloss.grid.table"} if gloss_grid else set()
    for name, value in model.named_parameters():
        assert torch.equal(value, before[name])
        changed = not torch.equal(value, rounded[name])
        assert changed == (name in tables), name
        if changed:
            assert torch.equal(rounded[name], (scale * value).half().float())


@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_features_beyond_float16_are_noticed(scale):
    model = sphere_model(output_scale=scale)
    assert fits_half(model)
    with torch.no_grad():
        model.fast.feature_grid.table[-1, -1] = -65_520.0 / scale
    assert not fits_half(model)


def test_errors_count_by_how_much_of_the_ray_is_seen():
    exact = {
        "opacity": np.array([[1.0], [0.0]]),
        "radiance": np.zeros((2, 3)),
        "distance": np.array([[4.0], [4.0]]),
    }
    rounded = {
        "opacity": exact["opacity"] + 0.1,
        "radiance": exact["radiance"] + 0.2,
        "distance": exact["distance"] + np.array([[1.0], [100.0]]),
    }
    found = {item.output: item for item in rounding_of(rounded, exact)}
    assert np.isclose(found["opacity"].rms_error, 0.1)
    assert np.isclose(found["radiance"].max_abs_error, 0.2)
    # Relative above 1; the second ray sees nothing, so its distance says nothing.
    assert np.isclose(found["distance"].max_abs_error, 0.25)
    assert np.isclose(found["distance"].rms_error, 0.25 / np.sqrt(2.0))
    assert found["distance"].num_samples == 2


def test_properties_of_points_count_in_full_without_an_opacity():
    (found,) = rounding_of({"albedo": np.full((1, 3), 0.6)}, {"albedo": np.full((1, 3), 0.5)})
    assert np.isclose(found.rms_error, 0.1)
