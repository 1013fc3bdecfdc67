"""A given mesh on an atlas: whose coordinates, whose materials, which normals, and where it may lie."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from flashcache.config import ExportConfig
from lambent_asset.bundle.glb import write_glb
from lambent_asset.given_mesh.given_charts import charts_of
from lambent_asset.given_mesh.given_surface import check_place, given_surface
from lambent_asset.given_mesh.glb_file import read_glb
from lambent_asset.mesh.mesh import occupied_box
from lambent_asset.textures.surface import build_surface
from lambent_asset.textures.surface_occlusion import bake_occlusion
from lambent_asset.textures.textures import bake_materials
from lambent_asset.transport.transport_rays import TriangleRays
from lambent_core.errors import UsageError
from lambent_relight.baked.raster import interpolate, rasterise_uv
from scipy.spatial import cKDTree
from support.given_glb import GlbWriter, glb_file, y_up
from support.sphere_model import RADIUS, sphere_model

EDITED = Path(__file__).parents[3] / "data" / "edited"
CONFIG = ExportConfig(mesh_resolution=24, max_faces=600, transport_size=64)


@pytest.fixture(scope="module")
def model():
    return sphere_model()


@pytest.fixture(scope="module")
def box(model):
    return occupied_box(model)


@pytest.fixture(scope="module")
def own(model, tmp_path_factory):
    """Return the trained surface, its textures, and its own file, read back."""
    surface = build_surface(model, CONFIG)
    textures = bake_materials(model, surface, np.ones(len(surface.texel_index), np.float32))
    path = tmp_path_factory.mktemp("own") / "own.glb"
    path.write_bytes(write_glb(surface, textures, unit="unknown"))
    return surface, textures, read_glb(path)


def covered(plane, surface):
    return plane.reshape(-1, plane.shape[-1])[surface.texel_index]


def on_atlas(model, given, box, config=CONFIG):
    return given_surface(model, given, config, box=box, pixel_size=0.0)


def test_an_unchanged_mesh_keeps_its_atlas_its_maps_and_its_normals(model, own, box):
    surface, textures, given = own
    made = on_atlas(model, given, box)
    assert made.kept_uv
    assert made.from_model == 0.0
    np.testing.assert_array_equal(made.surface.texel_index, surface.texel_index)
    np.testing.assert_allclose(made.reflectors.albedo, covered(textures.albedo, surface), atol=0.006)
    roughness = covered(textures.perceptual_roughness, surface)
    np.testing.assert_allclose(made.reflectors.perceptual_roughness, roughness, atol=0.003)
    cosine = (made.surface.texel_normals * surface.texel_normals).sum(axis=1)
    # The model's normals are as good as random: where one faces inwards, the map holds one that does not.
    assert np.median(cosine) > np.cos(np.radians(1.5))
    assert np.percentile(cosine, 5) > np.cos(np.radians(6.0))


def test_charts_that_overlap_are_unwrapped_and_colours_stay_on_their_places(model, own, box):
    _, _, given = own
    doubled = replace(given, uv=given.uv % 0.5)
    # Its own maps would be wrong at other coordinates: the maps go along with them.
    (maps,) = given.maps
    quarter = replace(doubled, maps=(replace(maps, albedo=maps.albedo[:32, :32]),))
    made, kept = on_atlas(model, quarter, box), on_atlas(model, given, box)
    assert kept.kept_uv
    assert not made.kept_uv
    places = quarter.uv * 2.0
    assert places.max() <= 1.0
    # Every texel has the colour of the file's picture at the file's coordinates.
    charts, _ = charts_of(quarter, CONFIG.transport_size)
    found = rasterise_uv(charts.uv, charts.faces, CONFIG.transport_size)
    uv = interpolate(found, charts.faces, quarter.uv[charts.source])
    np.testing.assert_allclose(made.reflectors.albedo, quarter.maps[0].albedo_at(uv), atol=1e-6)


def test_unwrapping_a_whole_atlas_anew_moves_no_colour(model, own, box):
    """Positions outside [0, 1] force new charts; the maps repeat, so that colours must not move."""
    _, _, given = own
    shifted = replace(given, uv=given.uv + 1.0)
    made, kept = on_atlas(model, shifted, box), on_atlas(model, given, box)
    assert not made.kept_uv
    _, nearest = cKDTree(kept.surface.positions).query(made.surface.positions)
    difference = np.abs(made.reflectors.albedo - kept.reflectors.albedo[nearest])
    assert np.median(difference) < 0.02
    turned = (made.surface.texel_normals * kept.surface.texel_normals[nearest]).sum(axis=1)
    assert np.median(turned) > np.cos(np.radians(8.0))


def test_a_part_without_a_material_takes_the_models(model, own, box):
    surface, textures, given = own
    made = on_atlas(model, replace(given, maps=(None,)), box)
    assert made.from_model == 1.0
    np.testing.assert_allclose(made.reflectors.albedo, covered(textures.albedo, surface), atol=0.05)
    difference = np.abs(made.reflectors.albedo - covered(textures.albedo, surface))
    assert difference.mean() < 0.002
    roughness = covered(textures.perceptual_roughness, surface)
    assert np.abs(made.reflectors.perceptual_roughness - roughness).mean() < 0.002


def test_a_mesh_without_coordinates_is_unwrapped_and_looks_like_the_model(model, own, box):
    _, _, given = own
    bare = replace(
        given, uv=np.zeros_like(given.uv), has_uv=(False,), maps=(None,), normals=0.0 * given.normals
    )
    made = on_atlas(model, bare, box)
    assert not made.kept_uv
    with torch.no_grad():
        at = torch.from_numpy(
            made.surface.positions / np.linalg.norm(made.surface.positions, axis=1)[:, None]
        )
        expected = model.materials(RADIUS * at).albedo.numpy()
    assert np.corrcoef(made.reflectors.albedo.ravel(), expected.ravel())[0, 1] > 0.7
    outwards = (made.surface.normals * made.surface.vertices).sum(axis=1)
    assert (outwards > 0.0).all()


def test_blenders_files_are_taken_as_they_are(model, box):
    edited, joined = (
        on_atlas(model, read_glb(EDITED / f"ball_{name}.glb"), box) for name in ("edited", "joined")
    )
    assert edited.kept_uv, "a subdivided and cut mesh still is an atlas"
    assert not joined.kept_uv, "the cube lies on the ball's charts"
    green = np.abs(joined.reflectors.albedo - [0.1, 0.6, 0.2]).max(axis=1) < 1e-5
    assert joined.surface.positions[green, 2].min() > 0.54
    assert joined.surface.positions[~green, 2].max() < 0.56
    np.testing.assert_allclose(joined.reflectors.perceptual_roughness[green], 0.4, atol=1e-6)
    np.testing.assert_allclose(joined.reflectors.metalness[green], 0.0, atol=1e-6)
    cube = joined.surface.positions[green] - [0.0, 0.0, 0.75]
    axis = np.abs(cube).argmax(axis=1)
    facing = joined.surface.texel_normals[green][np.arange(len(axis)), axis]
    np.testing.assert_allclose(facing, np.sign(cube[np.arange(len(axis)), axis]), atol=1e-3)


@pytest.mark.parametrize(("scale", "words"), [(100.0, "times as large"), (0.01, "times as large")])
def test_other_units_are_refused(own, box, scale, words):
    _, _, given = own
    with pytest.raises(UsageError, match=rf"mesh_file\.place.*{words}.*one scene unit is one metre"):
        check_place(replace(given, vertices=scale * given.vertices), box, "a.glb")


def test_a_mesh_far_away_is_refused_and_a_part_or_a_small_move_is_not(own, box):
    _, _, given = own
    with pytest.raises(UsageError, match=r"mesh_file\.place.*lies around \(5,"):
        check_place(replace(given, vertices=given.vertices + np.float32([5.0, 0.0, 0.0])), box, "a.glb")
    check_place(replace(given, vertices=given.vertices + np.float32([0.4, 0.0, 0.0])), box, "a.glb")
    check_place(replace(given, vertices=np.float32(0.1) * given.vertices), box, "a.glb")


def test_a_flat_square_faces_where_its_triangles_do(model, box, tmp_path):
    def square(writer: GlbWriter) -> None:
        corners = y_up([[-0.3, -0.3, 0.0], [0.3, -0.3, 0.0], [0.3, 0.3, 0.0], [-0.3, 0.3, 0.0]])
        writer.mesh(corners.astype(np.float32), material=writer.material({}, baseColorFactor=[1, 0, 0, 1]))

    made = on_atlas(model, read_glb(glb_file(tmp_path / "a.glb", square)), box)
    np.testing.assert_allclose(
        made.surface.texel_normals, [[0.0, 0.0, 1.0]] * len(made.surface.positions), atol=1e-6
    )
    np.testing.assert_allclose(made.surface.positions[:, 2], 0.0, atol=1e-6)
    assert len(made.surface.positions) == made.surface.size**2
    # All of the atlas is covered: transport keeps to its budget.
    assert made.surface.size**2 <= 0.515 * CONFIG.transport_size**2 < (made.surface.size + 16) ** 2


def test_the_occlusion_of_a_ball_is_what_its_bent_normals_see_below_the_tangent_plane(model, own, box):
    """The form factor of what is open is half of one plus the cosine between both normals."""
    _, _, given = own
    made = on_atlas(model, given, box)
    rays = TriangleRays(made.surface.vertices, made.surface.faces)
    found = bake_occlusion(made.surface, rays, origin_offset=rays.offset, num_points=10_000, num_rays=256)
    radial = made.surface.positions / np.linalg.norm(made.surface.positions, axis=1, keepdims=True)
    expected = 0.5 + 0.5 * (made.surface.texel_normals * radial).sum(axis=1)
    error = found - expected
    # Faces are up to five degrees off the ball.
    assert abs(error.mean()) < 0.005
    assert np.sqrt((error**2).mean()) < 0.04
    assert np.ptp(expected) > 0.3
