"""The database shares lenses, keeps matches over interruptions, and turns portrait photographs."""

import numpy as np
import pycolmap
import pytest
from lambent_capture.poses import database as db
from lambent_capture.poses.features import Features
from lambent_capture.poses.shots import Shot
from lambent_core.errors import Stopped

SIDE = 400
COUNT = 60


def views_of_a_cloud(count, *, portrait=()):
    """Return shots and features of a cloud of points that a camera goes along, with their descriptors."""
    rng = np.random.default_rng(0)
    cloud = np.column_stack([rng.uniform(-1.0, 1.0, (COUNT, 2)), rng.uniform(4.0, 6.0, COUNT)])
    descriptors = (255 * rng.random((COUNT, 128)) ** 4).astype(np.uint8)
    shots, features = [], []
    for number in range(count):
        seen = cloud - [0.2 * number - 0.4, 0.05 * number, 0.0]
        shot = Shot(width=SIDE, height=SIDE // 2)
        places = 200.0 * seen[:, :2] / seen[:, 2:] * [2.0, 1.0] + [SIDE / 2, SIDE / 4]
        angles = np.zeros(COUNT)
        if number in portrait:  # turned counterclockwise
            shot = Shot(width=SIDE // 2, height=SIDE)
            places = np.column_stack([places[:, 1], SIDE - places[:, 0]])
            angles -= 0.5 * np.pi
        points = np.column_stack([places, np.full(COUNT, 2.0), angles])
        shots.append(shot)
        features.append(Features(points=points.astype(np.float32), descriptors=descriptors))
    return shots, features


def pairs_in(path):
    with pycolmap.Database.open(path) as database:
        pairs, _ = database.read_two_view_geometries()
    return len(pairs)


def test_portrait_photographs_lie_down_beside_the_others_and_share_their_lens(tmp_path):
    shots, features = views_of_a_cloud(3, portrait=(1,))
    flat = views_of_a_cloud(3)[1]
    assert np.allclose(db.lying(features[1].points, shots[1], SIDE), flat[1].points, atol=1e-4)
    db.create_database(tmp_path / "d.db", shots, features, SIDE)
    with pycolmap.Database.open(tmp_path / "d.db") as database:
        (camera,) = database.read_all_cameras()
        images = database.read_all_images()
        assert np.allclose(database.read_keypoints(2), flat[1].points, atol=1e-4)
    assert (camera.width, camera.height) == (SIDE, SIDE // 2)
    assert [image.name for image in images] == ["000000", "000001", "000002"]


def test_zooms_have_lenses_of_their_own_and_exif_is_where_the_search_begins(tmp_path):
    shots, features = views_of_a_cloud(4)
    shots[1:3] = [Shot(width=2 * SIDE, height=SIDE, zoom=(9.0, 50.0, 0.0), focal_px=1000.0)] * 2
    db.create_database(tmp_path / "d.db", shots, features, SIDE)
    with pycolmap.Database.open(tmp_path / "d.db") as database:
        wide, long = database.read_all_cameras()
        assert [image.camera_id for image in database.read_all_images()] == [1, 2, 2, 1]
    assert (wide.has_prior_focal_length, long.has_prior_focal_length) == (False, True)
    assert wide.params[0] == pytest.approx(1.2 * SIDE)
    # In work pixels, half as many as stored ones.
    assert long.params[0] == pytest.approx(500.0)


def test_matching_goes_on_after_a_stop_and_gives_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr(db, "BLOCK", 2)
    shots, features = views_of_a_cloud(4)
    pairs = [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)]
    for name in ("whole", "cut"):
        db.create_database(tmp_path / f"{name}.db", shots, features, SIDE)

    def stop_soon(done, total):
        if done >= 2:
            raise Stopped

    with pytest.raises(Stopped):
        db.match_pairs(tmp_path / "cut.db", pairs, 0, stop_soon)
    assert pairs_in(tmp_path / "cut.db") == 2
    told = []
    db.match_pairs(tmp_path / "cut.db", pairs, 0, lambda done, total: told.append((done, total)))
    assert told == [(2, 5), (4, 5), (5, 5)]
    db.match_pairs(tmp_path / "whole.db", pairs, 0)
    assert db.verified_pairs(tmp_path / "cut.db") == db.verified_pairs(tmp_path / "whole.db")
    assert db.verified_pairs(tmp_path / "whole.db")[0, 1] > 0.8 * COUNT


def test_what_stands_still_is_no_match(tmp_path):
    shots, features = views_of_a_cloud(2)
    db.create_database(tmp_path / "d.db", shots, [features[0], features[0]], SIDE)
    db.match_pairs(tmp_path / "d.db", [(0, 1)], 0)
    assert db.verified_pairs(tmp_path / "d.db") == {}


def test_the_best_partner_has_most_in_common():
    assert db.partners({(0, 1): 20, (1, 2): 50, (0, 2): 20}) == {0: (1, 20), 1: (2, 50), 2: (1, 50)}


def test_colmap_is_quiet_and_its_level_comes_back(capfd):
    before = pycolmap.logging.minloglevel
    with db.quiet():
        pycolmap.logging.info("unheard")
    assert pycolmap.logging.minloglevel == before
    assert "unheard" not in capfd.readouterr().err
