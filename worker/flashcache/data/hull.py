"""The visual hull of a capture: where in the scene's box its masks allow the object to be.

Source: Laurentini, The visual hull concept for silhouette-based image understanding, PAMI 1994; here a cell
may be denied by a few views, since masks have mistakes, and no pixel of a mask is left without a cell.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray
from scipy.ndimage import binary_dilation, distance_transform_edt

from flashcache.data.scene import Camera, Scene, View
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.geometry.rays import pixel_directions
from flashcache.kernels.cells import count_cells
from flashcache.physical.model import InverseModel

_COVERED = 0.5
"""Coverage from which a pixel must keep a cell."""
_PIXELS = 8192
"""Pixels whose rays are followed at once."""
_LEAST_EMPTY = 0.02
"""Share of the pixels without the object below which masks say nothing."""


def fit_occupancy(model: InverseModel, scene: Scene) -> None:
    """Let a model hold something inside of the visual hull of `scene` only, where its masks tell of one."""
    occupancy = model.nerf.occupancy
    if occupancy is not None:
        cells = hull_of(scene, model.config.occupancy)
        if cells is not None:
            occupancy.set(torch.from_numpy(cells))


def hull_of(scene: Scene, config: OccupancyConfig) -> Bool[ndarray, "x y z"] | None:
    """Return the cells of the scene's box that may hold the object, or None where the masks tell nothing.

    A cell is kept if at most the share `config.dissent` of the views that see it have no mask within
    `config.margin_px` of it, or if a pixel of a mask shows no cell that is denied by fewer. One more layer of
    cells is added around all. Only the training views count; margins around their pictures show nothing.
    """
    masks = [_mask(view, scene.lights) for view in scene.train]
    if not masks or np.mean([(mask > 0.0).mean() for mask in masks]) > 1.0 - _LEAST_EMPTY:
        return None
    low, high = np.array(scene.bounds_min), np.array(scene.bounds_max)
    size = (high - low) / config.cells
    radius = 0.5 * float(np.linalg.norm(size))
    seen = np.zeros((config.cells,) * 3, np.int32)
    denied = np.zeros_like(seen)
    for view, mask in zip(scene.train, masks, strict=True):
        _count(view, mask, low, size, radius, config.margin_px, seen, denied)
    share = denied / np.maximum(seen, 1)
    kept = share <= config.dissent
    for view, mask in zip(scene.train, masks, strict=True):
        kept |= _least_denied(view.camera, mask, share, kept, low, size)
    return np.asarray(binary_dilation(kept, np.ones((3, 3, 3), bool)))


def _mask(view: View, lights: tuple[str, ...]) -> Float32[ndarray, "height width"]:
    """Return the largest coverage of each pixel under any light."""
    pictures = [picture[..., 3] for light, picture in view.images.items() if light in lights]
    return np.max(pictures, axis=0)


def _count(
    view: View,
    mask: Float32[ndarray, "height width"],
    low: Float[ndarray, "3"],
    size: Float[ndarray, "3"],
    radius: float,
    margin_px: float,
    seen: Int[ndarray, "x y z"],
    denied: Int[ndarray, "x y z"],
) -> None:
    """Count the cells that a view's whole frame shows, and those it shows without the object."""
    camera, margins = view.camera, view.margins
    # Distance of each pixel to the mask, pixels; infinite where the picture has none of it.
    away = distance_transform_edt(mask <= 0.0) if (mask > 0.0).any() else np.full(mask.shape, np.inf)
    world_to_camera = np.linalg.inv(camera.camera_to_world)[:3]
    lens = np.array([camera.focal_x, camera.focal_y, camera.centre_x, camera.centre_y])
    frame = np.array([margins.left, margins.top, margins.right, margins.bottom], np.float64)
    count_cells(
        world_to_camera, lens, frame, away.astype(np.float32), low, size, radius, margin_px, seen, denied
    )


def _least_denied(
    camera: Camera,
    mask: Float32[ndarray, "height width"],
    share: Float[ndarray, "x y z"],
    kept: Bool[ndarray, "x y z"],
    low: Float[ndarray, "3"],
    size: Float[ndarray, "3"],
) -> Bool[ndarray, "x y z"]:
    """Return for the pixels of a mask that show no cell that is kept those that the fewest views deny."""
    more = np.zeros_like(kept)
    rows, columns = np.nonzero(mask > _COVERED)
    for first in range(0, len(rows), _PIXELS):
        some = slice(first, first + _PIXELS)
        cells = _along(camera, columns[some] + 0.5, rows[some] + 0.5, low, size, len(share))
        inside = cells[..., 0] >= 0
        index = tuple(np.maximum(cells, 0).transpose(2, 0, 1))
        lonely = inside.any(axis=1) & ~(kept[index] & inside).any(axis=1)
        if not lonely.any():
            continue
        index = tuple(each[lonely] for each in index)
        denied = np.where(inside[lonely], share[index], np.inf)
        least = denied <= denied.min(axis=1, keepdims=True)
        more[tuple(each[least] for each in index)] = True
    return more


def _along(
    camera: Camera,
    columns: Float[ndarray, " rays"],
    rows: Float[ndarray, " rays"],
    low: Float[ndarray, "3"],
    size: Float[ndarray, "3"],
    count: int,
) -> Int[ndarray, "rays steps 3"]:
    """Return the cells that rays through pixels pass, a cell's length apart; -1 outside of the box.

    `columns` and `rows` are places in the picture, pixels; `low` and `size` the lattice's corner and a cell's
    sides, scene units.
    """
    lens = torch.tensor([camera.focal_x, camera.focal_y]), torch.tensor([camera.centre_x, camera.centre_y])
    pose = torch.from_numpy(camera.camera_to_world).float()
    place = torch.from_numpy(columns).float(), torch.from_numpy(rows).float()
    directions = pixel_directions(*place, *lens, pose).numpy()
    middle = low + 0.5 * count * size
    half = 0.5 * count * float(np.linalg.norm(size))
    start = max(float(np.linalg.norm(camera.position - middle)) - half, 0.0)
    t = start + (np.arange(int(np.ceil(2.0 * half / float(size.min())))) + 0.5) * float(size.min())
    points = camera.position + t[:, None] * directions[:, None]
    cells = np.floor((points - low) / size).astype(np.int32)
    return np.where(((cells >= 0) & (cells < count)).all(axis=-1, keepdims=True), cells, -1)
