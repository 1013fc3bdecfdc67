"""Mitsuba receives the bundle's mesh in world axes, and cameras in its own convention."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from make_sample_scene import llvm_library, load_renderer
from support.lit_sphere import RADIUS, camera
from support.measured_sphere import measured_views

from benchmarks.mitsuba_inverse import (
    Asset,
    Inversion,
    Settings,
    neighbours,
    picture,
    read_mesh,
    sensor,
    surface_maps,
)


@pytest.fixture
def renderer() -> None:
    if llvm_library() is None:
        pytest.skip("needs an LLVM library to render with (Debian: libllvm19)")
    load_renderer()


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=RADIUS)


def test_a_mesh_comes_back_with_z_up(tmp_path: Path):
    mesh = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    mesh.apply_translation((0.1, 0.2, 5.0))
    stored = mesh.copy()
    stored.vertices = mesh.vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    stored.export(tmp_path / "asset.glb")
    found = read_mesh(tmp_path / "asset.glb")
    assert np.allclose(found.bounds, mesh.bounds, atol=1e-5)


def test_vertices_on_both_sides_of_a_seam_are_neighbours():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], float)
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [3, 5, 4]], process=False)
    pairs = {tuple(sorted(pair)) for pair in neighbours(mesh).tolist()}
    assert pairs == {(0, 1), (0, 2), (1, 2), (3, 4), (3, 5), (4, 5), (1, 3), (2, 4)}


def test_a_camera_whose_axis_is_off_the_middle_is_refused():
    with pytest.raises(SystemExit, match="centred"):
        sensor(replace(camera(0.0, 0.3), centre_x=3.0))


@pytest.mark.slow
def test_surface_maps_see_the_mesh_where_the_true_camera_does(renderer: None, ball: trimesh.Trimesh):
    view = measured_views()[2]
    asset = Asset(ball, np.ones((8, 16, 3), np.float32))
    maps = surface_maps(asset, view.camera)
    truth = view.truth["normal"]
    assert np.abs(maps["albedo"][..., 3] - truth[..., 3]).mean() < 0.01
    inside = truth[..., 3] > 0.99
    agreement = (maps["normal"] * truth[..., :3]).sum(axis=-1)[inside]
    assert np.degrees(np.arccos(agreement.clip(-1.0, 1.0))).mean() < 2.0
    assert maps["roughness"][inside] == pytest.approx(0.52, abs=1e-5)


@pytest.mark.slow
def test_a_white_sky_shines_on_every_side_alike(renderer: None, ball: trimesh.Trimesh):
    asset = Asset(ball, np.ones((8, 16, 3), np.float32))
    seen = picture(asset.scene, camera(0.4, 0.2), samples=16, seed=0)
    inside = seen[..., 3] > 0.99
    upper, lower = (seen[part][inside[part]][:, :3].mean() for part in (slice(0, 12), slice(12, 24)))
    assert upper == pytest.approx(lower, rel=0.03)


@pytest.mark.slow
def test_steps_bring_the_picture_closer_to_the_photographs(renderer: None, ball: trimesh.Trimesh):
    views = tuple(measured_views(4, 24))
    asset = Asset(ball, np.full((9, 18, 3), 0.5, np.float32))

    def error() -> float:
        seen = [picture(asset.scene, view.camera, samples=16, seed=1) for view in views]
        return float(np.mean([np.abs(a[..., :3] - _encoded(b)) for a, b in zip(seen, views, strict=True)]))

    before = error()
    inversion = Inversion(asset, views, "sky", Settings(rate=0.1, light_rate=0.1, samples=4))
    while inversion.steps < 16:  # Not for a time: a busy machine takes few steps in it.
        done = inversion.steps
        inversion.run(0.1)
        assert inversion.steps > done
    assert error() < 0.9 * before


def _encoded(view) -> np.ndarray:
    linear = view.images["sky"][..., :3].astype(np.float64)
    return np.where(
        linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055
    )
