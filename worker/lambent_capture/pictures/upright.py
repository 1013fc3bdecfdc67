"""The way up of a photograph: as its camera was held in the world, whose third axis points up.

Pixels of files stay as they are stored: cameras were solved for these. Photographs that lie on their side are
turned where people look at them, and where they become views of a bundle.
"""

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

CLEARLY = 0.25
"""How much more upright a picture must get to be turned: cameras that look down have no upper side."""


def upright_turns(camera_to_world: Float[ndarray, "4 4"]) -> int:
    """Return by how many quarter turns to the left (`numpy.rot90`) a picture gets upright, 0 to 3.

    The camera's axes are x right, y up; up in the world is its third axis.
    """
    right, up = camera_to_world[2, 0], camera_to_world[2, 1]
    heights = np.array([up, right, -up, -right])
    best = int(heights.argmax())
    return best if heights[best] > heights[0] + CLEARLY else 0


def turned_pose(camera_to_world: Float[ndarray, "4 4"], turns: int) -> Float[ndarray, "4 4"]:
    """Return camera-to-world of a picture that was turned to the left so many times."""
    pose = camera_to_world.copy()
    for _ in range(turns % 4):
        pose[:, :2] = np.stack([-pose[:, 1], pose[:, 0]], axis=1)
    return pose


def turned_pixels(pixels: Shaped[ndarray, "height width *channels"], turns: int) -> ndarray:
    """Return pixels after so many quarter turns to the left, in rows that follow each other in memory."""
    return np.ascontiguousarray(np.rot90(pixels, turns))


def turned_size(size: tuple[int, int], turns: int) -> tuple[int, int]:
    """Return width and height after so many quarter turns."""
    return size if turns % 2 == 0 else (size[1], size[0])
