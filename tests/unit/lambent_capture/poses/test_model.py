"""Solved models are written for the original files: their names, their size, the way they are stored."""

import numpy as np
import pycolmap
import pytest
from lambent_capture.poses.agreement import contradicted
from lambent_capture.poses.database import as_stored
from lambent_capture.poses.model import camera_poses, full_size_model, turn, widest_field_deg, write_model
from lambent_capture.poses.shots import Shot
from lambent_capture.scenes.world import shortest_turn

WORK_SIDE = 1024
"""Longer side of the synthetic pictures."""
COUNT = 6


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    """Return a synthetic model in work pixels, and its database."""
    path = tmp_path_factory.mktemp("synthetic") / "d.db"
    options = pycolmap.SyntheticDatasetOptions()
    options.num_frames_per_rig = COUNT
    options.num_rigs = 1
    options.num_cameras_per_rig = 1
    options.num_points3D = 80
    pycolmap.set_random_seed(1)
    with pycolmap.Database.open(path) as database:
        model = pycolmap.synthesize_dataset(options, database)
        for number, image_id in enumerate(sorted(model.reg_image_ids())):
            model.image(image_id).name = as_stored(number)
    camera = next(iter(model.cameras.values()))
    assert (camera.width, camera.model.name) == (WORK_SIDE, "SIMPLE_RADIAL")
    return model, path


def shots_of(model, scale, portrait):
    camera = next(iter(model.cameras.values()))
    size = round(scale * camera.width), round(scale * camera.height)
    return [
        Shot(width=size[n in portrait], height=size[n not in portrait]) for n in range(model.num_reg_images())
    ]


def worst_error_px(model):
    return max(
        np.linalg.norm(image.project_point(model.point3D(point.point3D_id).xyz) - point.xy)
        for image in model.images.values()
        for point in image.points2D
        if point.has_point3D()
    )


@pytest.mark.parametrize("portrait", [(), (1, 4), tuple(range(COUNT))])
def test_points_are_seen_where_they_are_in_the_stored_pictures(solved, portrait):
    model, _ = solved
    names = [f"trip/IMG {n}.HEIC" for n in range(COUNT)]
    full = full_size_model(model, names, shots_of(model, 3.0, portrait), WORK_SIDE)
    assert sorted(image.name for image in full.images.values()) == names
    assert full.num_points3D() == model.num_points3D()
    assert worst_error_px(full) == pytest.approx(3.0 * worst_error_px(model), abs=1e-6)
    lenses = list(full.cameras.values())
    assert len(lenses) == (2 if len(portrait) == 2 else 1)
    assert len({lens.params[0] for lens in lenses}) == 1
    assert widest_field_deg(full) == pytest.approx(widest_field_deg(model))
    for number in portrait:
        image = full.find_image_with_name(names[number])
        assert image.camera.height > image.camera.width


def test_a_written_model_is_read_again(solved, tmp_path):
    model, _ = solved
    names = [f"{n}.jpg" for n in range(COUNT)]
    full = full_size_model(model, names, shots_of(model, 2.0, (2,)), WORK_SIDE)
    write_model(full, tmp_path / "sparse" / "0")
    again = pycolmap.Reconstruction(tmp_path / "sparse" / "0")
    assert again.is_valid()
    found, wanted = camera_poses(again), camera_poses(full)
    assert found.keys() == wanted.keys()
    assert all(np.allclose(found[name], wanted[name], atol=1e-12) for name in found)


def test_a_turned_world_turns_cameras_and_points_alike(solved):
    model, _ = solved
    names = [f"{n}.jpg" for n in range(COUNT)]
    full = full_size_model(model, names, shots_of(model, 1.0, ()), WORK_SIDE)
    before, error = camera_poses(full), worst_error_px(full)
    up = np.array([0.6, -0.48, 0.64])
    turn(full, shortest_turn(up))
    assert worst_error_px(full) == pytest.approx(error, abs=1e-6)
    for name, pose in camera_poses(full).items():
        assert np.allclose(pose[:3, :3], shortest_turn(up) @ before[name][:3, :3], atol=1e-9)


def test_a_camera_against_the_evidence_is_found_and_the_others_are_not_blamed(solved):
    model, database = solved
    assert contradicted(model, database) == []
    wrong = pycolmap.Reconstruction(model)
    image = wrong.image(sorted(wrong.reg_image_ids())[2])
    matrix = image.cam_from_world().matrix()
    aside = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    image.frame.rig_from_world = pycolmap.Rigid3d(np.column_stack([aside @ matrix[:, :3], matrix[:, 3]]))
    assert contradicted(wrong, database) == [image.image_id]
