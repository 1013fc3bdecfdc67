"""Masks of what moves in front of a camera that stands still, on drawn turntables."""

import functools

import cv2
import numpy as np
import pytest
from lambent_capture.masks.motion import find_motion, write_motion_masks
from PIL import Image

HEIGHT, WIDTH = 120, 160
COUNT = 12
MIDDLE, RADIUS = (80, 62), 26


@functools.cache
def room(seed: int = 0) -> np.ndarray:
    """Return a room with things in it, sRGB."""
    random = np.random.default_rng(seed)
    picture = np.full((HEIGHT, WIDTH, 3), (150, 140, 120), np.uint8)
    for _ in range(30):
        low = random.integers(0, (WIDTH, HEIGHT))
        high = low + random.integers(6, 30, 2)
        colour = random.integers(30, 220, 3).tolist()
        cv2.rectangle(picture, low.tolist(), high.tolist(), colour, cv2.FILLED)
    return picture


def object_at(turn: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a textured ball with a handle at a turn, and where it is."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (columns - MIDDLE[0]) / RADIUS, (rows - MIDDLE[1]) / RADIUS
    ball = x**2 + y**2 < 1.0
    longitude = np.arcsin(np.clip(x / np.sqrt(np.maximum(1.0 - y**2, 1e-3)), -1, 1)) + turn
    stripes = np.stack([np.sin(k * longitude + 2.0 * y) for k in (3, 5, 7)], axis=-1)
    picture = (120 + 90 * stripes * (1.0 - 0.3 * y[..., None] ** 2)).clip(5, 250).astype(np.uint8)
    handle = np.zeros((HEIGHT, WIDTH), np.uint8)
    end = (round(MIDDLE[0] + 1.7 * RADIUS * np.sin(turn)), MIDDLE[1] + 4)
    cv2.line(handle, MIDDLE, end, 1, 7)
    picture[(handle > 0) & ~ball] = (200, 60, 50)
    return picture, ball | (handle > 0)


def capture(*, shadow: float = 0.0, exposure: float = 0.0, noise: float = 3.0):
    """Return photographs of a turntable, and the truth of their masks."""
    random = np.random.default_rng(1)
    pictures, masks = [], []
    for number in range(COUNT):
        turn = 2.0 * np.pi * number / COUNT
        thing, mask = object_at(turn)
        picture = room().astype(np.float64)
        if shadow:
            cast = np.zeros((HEIGHT, WIDTH), np.uint8)
            end = (round(MIDDLE[0] + 50 * np.sin(turn + 0.5)), 105)
            cv2.line(cast, (MIDDLE[0], 98), end, 1, 12)
            picture[cast > 0] *= 1.0 - shadow
        picture[mask] = thing[mask]
        gain = 2.0 ** (exposure * np.sin(2.4 * number) / 2.2)
        picture = picture * gain + random.normal(0.0, noise, picture.shape)
        pictures.append(np.round(picture.clip(0, 255)).astype(np.uint8))
        masks.append(mask)
    return pictures, masks


def overlaps(pictures, truth) -> list[float]:
    found = find_motion(pictures)
    assert found is not None
    return [(a & b).sum() / (a | b).sum() for a, b in zip(found.masks, truth, strict=True)]


def covered(pictures, truth) -> float:
    """Return the least share of the object that a mask has."""
    found = find_motion(pictures)
    return min((a & b).sum() / b.sum() for a, b in zip(found.masks, truth, strict=True))


def test_the_object_is_what_moves():
    pictures, truth = capture()
    assert min(overlaps(pictures, truth)) > 0.75
    assert covered(pictures, truth) > 0.97


def test_a_shadow_on_the_room_is_no_object():
    pictures, truth = capture(shadow=0.45)
    plain = np.mean(overlaps(*capture()))
    assert np.mean(overlaps(pictures, truth)) > plain - 0.04


def test_changes_of_exposure_are_no_motion():
    pictures, truth = capture(exposure=0.7)
    assert min(overlaps(pictures, truth)) > 0.7


def test_a_camera_that_moves_shows_no_turntable():
    pictures, _ = capture()
    moved = [
        np.roll(picture, (3 * number, 7 * number), axis=(0, 1)) for number, picture in enumerate(pictures)
    ]
    assert find_motion(moved) is None


def test_white_paper_behind_a_carried_camera_is_no_turntable():
    pictures, masks = capture(noise=1.0)
    on_paper = [
        np.where(mask[..., None], picture, 245) for picture, mask in zip(pictures, masks, strict=True)
    ]
    assert find_motion([picture.astype(np.uint8) for picture in on_paper]) is None


def test_nothing_that_moves_is_no_turntable():
    assert find_motion([room()] * 8) is None


@pytest.mark.parametrize("pictures", [[room()] * 3, [*[room()] * 8, room()[:, :-2]]])
def test_too_few_photographs_or_other_sizes_tell_nothing(pictures):
    assert find_motion(pictures) is None


def test_masks_are_written_at_the_size_of_the_photographs(tmp_path):
    pictures, truth = capture()
    paths = []
    for number, picture in enumerate(pictures):
        paths.append(tmp_path / f"{number}.png")
        Image.fromarray(picture).resize((4 * WIDTH, 4 * HEIGHT)).save(paths[-1])
    steps = []
    found = write_motion_masks(
        paths, [f"a/{n}" for n in range(COUNT)], tmp_path / "masks", lambda *step: steps.append(step)
    )
    assert found is not None
    assert steps[-1] == ("looking for what moves", COUNT - 1, COUNT)
    written = np.asarray(Image.open(tmp_path / "masks" / "a" / "5.png"))
    assert written.shape == (4 * HEIGHT, 4 * WIDTH)
    assert set(np.unique(written)) == {0, 255}
    small = written[2::4, 2::4] > 0
    assert (small & truth[5]).sum() / (small | truth[5]).sum() > 0.75
