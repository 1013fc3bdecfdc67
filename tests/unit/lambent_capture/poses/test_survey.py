"""Few points tell which pairs show the same, and whether the background stands still."""

import numpy as np
import pytest
from lambent_capture.poses.features import Features
from lambent_capture.poses.survey import choose_pairs, mutual_matches, natural_key, survey

SIDE = 1000.0


def unit(rng, count):
    descriptors = rng.random((count, 128)).astype(np.float32) ** 4
    return descriptors / np.linalg.norm(descriptors, axis=1, keepdims=True)


def seen(places, descriptors):
    points = np.column_stack([places, np.full(len(places), 3.0), np.zeros(len(places))])
    return Features(
        points=points.astype(np.float32), descriptors=np.round(255 * descriptors).astype(np.uint8)
    )


def around(count, *, background, moving, step=60.0):
    """Return features of `count` photographs: a still background, and points that move by `step`."""
    rng = np.random.default_rng(0)
    still, turning = unit(rng, background), unit(rng, moving)
    home, start = rng.uniform(0.0, SIDE, (background, 2)), rng.uniform(0.2 * SIDE, 0.4 * SIDE, (moving, 2))
    sights = []
    for number in range(count):
        wobble = rng.normal(0.0, 0.3, (background, 2))
        places = np.vstack([home + wobble, start + step * number])
        sights.append(seen(places, np.vstack([still, turning])))
    return survey(sights, [SIDE] * count, 768)


def test_a_background_that_stands_still_is_told_from_a_camera_that_is_carried():
    turntable = around(8, background=60, moving=40)
    assert turntable.still_share == 1.0
    assert turntable.still[0, 7] == 60
    assert turntable.moved[0, 7] == 40
    assert around(8, background=0, moving=80).still_share == 0.0


def test_a_date_stamp_is_no_background():
    rng = np.random.default_rng(1)
    stamp, scene = unit(rng, 30), unit(rng, 50)
    corner = rng.uniform(0.9 * SIDE, SIDE, (30, 2))
    sights = [
        seen(np.vstack([corner, rng.uniform(0.0, SIDE, (50, 2))]), np.vstack([stamp, scene]))
        for _ in range(6)
    ]
    found = survey(sights, [SIDE] * 6, 768)
    assert found.still.max() >= 30
    assert found.still_share == 0.0


def test_a_few_photographs_from_one_spot_are_no_tripod():
    rng = np.random.default_rng(2)
    things = unit(rng, 80)
    spots = [rng.uniform(0.0, SIDE, (80, 2)) for _ in range(8)]
    spots[3] = spots[2] = spots[1]
    assert survey([seen(spot, things) for spot in spots], [SIDE] * 8, 768).still_share == 0.0


def test_progress_reaches_all_pairs():
    told = []
    rng = np.random.default_rng(0)
    sights = [seen(rng.uniform(0.0, SIDE, (5, 2)), unit(rng, 5)) for _ in range(5)]
    survey(sights, [SIDE] * 5, 768, lambda done, total: told.append((done, total)))
    assert told[-1] == (10, 10)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


def test_matches_are_mutual_and_clear():
    rng = np.random.default_rng(3)
    here = unit(rng, 50)
    order = rng.permutation(50)
    noisy = here[order] + rng.normal(0.0, 0.01, (50, 128)).astype(np.float32)
    there = noisy / np.linalg.norm(noisy, axis=1, keepdims=True)
    matches = mutual_matches(here @ there.T)
    assert len(matches) == 50
    assert np.array_equal(order[matches[:, 1]], matches[:, 0])
    # Twice the same point is not clear.
    twice = np.vstack([there, there[:1]])
    assert len(mutual_matches(here @ twice.T)) == 49
    assert len(mutual_matches(here[:1] @ there.T)) == 0


def likeness_of_a_ring(count, reach):
    gaps = np.abs(np.arange(count)[:, None] - np.arange(count))
    gaps = np.minimum(gaps, count - gaps)
    return np.where((gaps > 0) & (gaps <= reach), 100 - 10 * gaps, 0)


def test_pairs_grow_with_the_photographs_and_not_with_their_square():
    for count in (40, 80):
        names = [f"IMG_{i}.jpg" for i in range(count)]
        pairs = choose_pairs(likeness_of_a_ring(count, 6), names, 8)
        assert len(pairs) <= 8 * count
        assert len(set(pairs)) == len(pairs)
        assert all(first < second for first, second in pairs)


def test_alike_photographs_are_paired_whatever_their_names():
    rng = np.random.default_rng(4)
    order = rng.permutation(30)
    likeness = likeness_of_a_ring(30, 3)[np.ix_(order, order)]
    pairs = set(choose_pairs(likeness, [f"{rng.random()}" for _ in range(30)], 6))
    assert {(a, b) for a, b in zip(*np.nonzero(np.triu(likeness)), strict=True)} <= pairs


@pytest.mark.parametrize("seed", range(3))
def test_all_photographs_are_connected(seed):
    rng = np.random.default_rng(seed)
    likeness = np.triu(rng.integers(0, 50, (25, 25)), 1)
    likeness[:12, 12:] //= 40
    likeness = likeness + likeness.T
    pairs = choose_pairs(likeness, [str(rng.random()) for _ in range(25)], 1)
    group = list(range(25))
    for first, second in pairs:
        old, new = group[second], group[first]
        group = [new if one == old else one for one in group]
    assert len(set(group)) == 1


def test_neighbours_in_the_order_of_names_are_paired():
    names = ["IMG_10.jpg", "IMG_9.jpg", "IMG_8.jpg", "IMG_11.jpg", "IMG_12.jpg", "IMG_13.jpg"]
    pairs = choose_pairs(np.zeros((6, 6), int), names, 0)
    assert {(0, 1), (1, 2), (0, 3), (3, 4), (4, 5), (0, 2)} <= set(pairs)
    assert sorted(names, key=natural_key)[0] == "IMG_8.jpg"
    assert choose_pairs(np.zeros((1, 1), int), ["a"], 8) == []
