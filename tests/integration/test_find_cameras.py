"""Cameras are found for photographs as people take them: sideways, interrupted, with bad ones among them."""

import shutil

import numpy as np
import pycolmap
import pytest
from lambent_capture.poses.advice import PoseLimits, advise
from lambent_capture.poses.photographs import find_photographs
from lambent_capture.poses.solve import PoseSettings, solve_cameras
from lambent_capture.problems import Problems
from lambent_core.errors import Stopped
from PIL import Image, ImageFilter
from scipy import ndimage
from support.textured_box import SIDE, box_cameras, box_picture

from benchmarks.pose_errors import pose_errors

pytestmark = pytest.mark.slow

COUNT = 9
SETTINGS = PoseSettings(max_features=2000)
ORIENTATION = 0x0112


@pytest.fixture(scope="module")
def box():
    """Return pictures of the box on its plate [height, width, 3], what is box or plate, and true poses."""
    cameras = box_cameras(COUNT, arc_deg=120.0)
    pictures = [box_picture(camera) for camera in cameras]
    return [p for p, _ in pictures], [m for _, m in pictures], [c.camera_to_world for c in cameras]


def write(folder, pictures, **options):
    folder.mkdir(parents=True, exist_ok=True)
    for number, pixels in enumerate(pictures):
        Image.fromarray(pixels).save(folder / f"photo {number:02d}.png", **options)
    return folder


def solve(folder, work, progress=lambda phase, done, total: None, masks=None):
    """Return the solution, and codes and messages of what is said about it."""
    problems = Problems()
    photographs = find_photographs(folder, masks, problems)
    solution = solve_cameras(photographs, work, SETTINGS, progress)
    advise(solution, PoseLimits(), problems)
    return solution, {finding.code: finding.message for finding in problems.findings()}


def errors(solution, true):
    """Return the worst rotation [deg] and centre (share) of all photographs named in `true`."""
    found = np.array([solution.camera_to_world[name] for name in true]) * np.array([1.0, -1.0, -1.0, 1.0])
    rotation, centre = pose_errors(found, np.array(list(true.values())))
    return rotation.max(), centre.max()


def named(poses):
    return {f"photo {number:02d}.png": pose for number, pose in enumerate(poses)}


def test_a_search_that_is_ended_goes_on_and_finds_the_same(box, tmp_path):
    pictures, _, true = box
    folder = write(tmp_path / "photographs", pictures)
    told = []
    whole, _ = solve(folder, tmp_path / "whole", lambda *numbers: told.append(numbers))
    assert errors(whole, named(true))[0] < 0.2
    assert list(dict.fromkeys(phase for phase, _, _ in told)) == [
        "features",
        "survey",
        "pairs",
        "cameras",
    ]
    assert ("cameras", COUNT, COUNT) in told
    for phase, at in (("features", 4), ("survey", 1), ("pairs", 1), ("cameras", 5)):

        def ended(now, done, total, phase=phase, at=at):
            if now == phase and done >= at:
                raise Stopped

        with pytest.raises(Stopped):
            solve(folder, tmp_path / "cut", ended)
    assert not list(tmp_path.rglob("*.partial"))
    told.clear()
    again, _ = solve(folder, tmp_path / "cut", lambda *numbers: told.append(numbers))
    assert ("pairs", 0, 1) not in told
    assert again.camera_to_world.keys() == whole.camera_to_world.keys()
    for name, pose in whole.camera_to_world.items():
        assert np.allclose(again.camera_to_world[name], pose, atol=1e-4)
    told.clear()
    known, _ = solve(folder, tmp_path / "cut", lambda *numbers: told.append(numbers))
    assert {phase for phase, _, _ in told} == {"features"}
    assert known.partners == again.partners
    assert known.up == again.up


def test_photographs_on_their_side_share_the_lens_and_tell_where_up_was(box, tmp_path):
    pictures, _, true = box
    folder = tmp_path / "photographs"
    # Landscape; turned to portrait by a program; as a telephone stores portrait, with EXIF.
    crops = [picture[SIDE // 8 : -SIDE // 8] for picture in pictures]
    for number, crop in enumerate(crops):
        write(folder, [])
        turned = np.ascontiguousarray(np.rot90(crop)) if number % 3 == 1 else crop
        exif = Image.Exif()
        if number % 3 == 2:
            # Held so that the scene's up is at the left of what is stored.
            turned, exif[ORIENTATION] = np.ascontiguousarray(np.rot90(crop)), 6
        Image.fromarray(turned).save(folder / f"{number}.png", exif=exif)
    solution, said = solve(folder, tmp_path / "work")
    assert len(solution.camera_to_world) == COUNT, said
    model = pycolmap.Reconstruction(solution.model)
    lenses = sorted((camera.width, camera.height, camera.params[0]) for camera in model.cameras.values())
    assert [lens[:2] for lens in lenses] == [(240, 320), (320, 240)]
    assert lenses[0][2] == lenses[1][2] == pytest.approx(400.0, rel=0.02)
    quarter = np.eye(4)
    quarter[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]]
    wanted = {}
    for number, pose in enumerate(true):
        # Stored axes of a picture turned counterclockwise: its right side was the lower one.
        wanted[f"{number}.png"] = pose if number % 3 == 0 else pose @ quarter
    rotation, centre = errors(solution, wanted)
    assert rotation < 0.3
    assert centre < 0.01
    assert solution.up == (0.0, 0.0, 1.0)


def test_the_stored_pixels_count_whatever_exif_says_of_their_orientation(box, tmp_path):
    pictures, _, true = box
    exif = Image.Exif()
    exif[ORIENTATION] = 6
    solution, _ = solve(write(tmp_path / "photographs", pictures, exif=exif), tmp_path / "work")
    assert errors(solution, named(true))[0] < 0.2
    assert set(solution.up_turns) == {3}


def test_photographs_stored_as_mirror_images_are_solved_as_the_scene_was(box, tmp_path):
    pictures, _, true = box
    exif = Image.Exif()
    exif[ORIENTATION] = 2
    mirrored = [np.ascontiguousarray(picture[:, ::-1]) for picture in pictures]
    solution, _ = solve(write(tmp_path / "photographs", mirrored, exif=exif), tmp_path / "work")
    assert errors(solution, named(true))[0] < 0.2
    assert set(solution.up_turns) == {0}


def turntable(box):
    """Return pictures in which a background with texture stands still behind the box."""
    spots = ndimage.gaussian_filter(np.random.default_rng(3).normal(size=(SIDE, SIDE, 3)), (1.5, 1.5, 0.0))
    background = np.clip(128.0 + 240.0 * spots, 0.0, 255.0).astype(np.uint8)
    return [np.where(mask[..., None], picture, background) for picture, mask in zip(*box[:2], strict=True)]


def test_a_turntable_is_recognised_and_solved_by_what_moves(box, tmp_path):
    solution, said = solve(write(tmp_path / "photographs", turntable(box)), tmp_path / "work")
    assert solution.static_background
    assert solution.still_share > 0.9
    assert "--light-fixed-to camera" in said["scene.static_background"]
    rotation, centre = errors(solution, named(box[2]))
    assert rotation < 0.5
    assert centre < 0.01


def test_a_turntable_is_recognised_behind_masks_too(box, tmp_path):
    folder = write(tmp_path / "photographs", turntable(box))
    write(tmp_path / "cut", [mask.astype(np.uint8) * 255 for mask in box[1]])
    solution, _ = solve(folder, tmp_path / "work", masks=tmp_path / "cut")
    assert solution.static_background
    assert errors(solution, named(box[2]))[0] < 0.5
    # The whole photographs are looked at once more when the masks are gone, and nothing else is done twice.
    assert len(list((tmp_path / "work" / "features").glob("*.npz"))) == 2 * COUNT


def test_bad_photographs_are_left_out_and_named(box, tmp_path):
    folder = write(tmp_path / "photographs", box[0])
    shutil.copy(folder / "photo 03.png", folder / "twin.png")
    with Image.open(folder / "photo 04.png") as picture:
        picture.filter(ImageFilter.GaussianBlur(12)).save(folder / "blurred.png")
    rng = np.random.default_rng(0)
    Image.fromarray(rng.integers(0, 256, (SIDE, SIDE, 3), dtype=np.uint8)).save(folder / "unrelated.png")
    Image.fromarray(box[0][5]).save(folder / "cut.jpg")
    (folder / "cut.jpg").write_bytes((folder / "cut.jpg").read_bytes()[:3000])
    (folder / "text.jpg").write_text("no picture")
    solution, said = solve(folder, tmp_path / "work")
    assert set(named(box[2])) | {"twin.png"} == set(solution.camera_to_world)
    assert errors(solution, named(box[2]))[0] < 0.2
    assert "cut.jpg cannot be decoded" in said["scene.image_broken"]
    assert "text.jpg" in said["scene.image_not_a_picture"]
    assert "blurred.png, unrelated.png" in said["scene.poses_incomplete"]


def test_mixed_objects_leave_the_larger_one(box, tmp_path):
    folder = write(tmp_path / "photographs", box[0])
    for number in range(5):  # a mirrored box is another box
        Image.fromarray(box[0][number][:, ::-1]).save(folder / f"mirrored {number}.png")
    solution, said = solve(folder, tmp_path / "work")
    assert set(solution.camera_to_world) == set(named(box[2]))
    assert "mirrored 1.png" in said["scene.poses_incomplete"]
    assert "mirrored 1.png" in said["scene.poses_split"]


def test_photographs_of_one_view_are_refused_with_what_to_do(box, tmp_path):
    solution, said = solve(write(tmp_path / "photographs", [box[0][0]] * 5), tmp_path / "work")
    assert solution.nothing_moved
    assert not solution.camera_to_world
    assert "the same view: walk around the object" in said["scene.poses_none"]


def test_photographs_that_change_are_looked_at_again_and_no_others(box, tmp_path):
    folder = write(tmp_path / "photographs", box[0][:6])
    solve(folder, tmp_path / "work")
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "work" / "features").iterdir()}
    Image.fromarray(box[0][6]).save(folder / "photo 06.png")
    solution, _ = solve(folder, tmp_path / "work")
    assert len(solution.camera_to_world) == 7
    after = {path: path.stat().st_mtime_ns for path in (tmp_path / "work" / "features").iterdir()}
    assert kept.items() <= after.items()
    assert len(after) == 7
