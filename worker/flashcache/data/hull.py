"""The visual hull of a capture: where in the scene's box its masks allow the object to be.

Source: Laurentini, The visual hull concept for silhouette-based image understanding, PAMI 1994; here a cell
may be denied by a few views, since masks have mistakes, and no pixel of a mask is left without a cell.
"""

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from lambent_core.scene import Camera, Scene, View
from numpy import ndarray
from scipy.ndimage import binary_dilation, distance_transform_edt

from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions
from flashcache.kernels import dispatch
from flashcache.kernels.cells import count_cells
from flashcache.physical.model import InverseModel

_COVERED = 0.5
"""Coverage from which a pixel must keep a cell."""
_AGREED = 0.005
"""Share of the masks' pixels that may show no undenied cell for masks that agree."""
_LEAST_EMPTY = 0.02
"""Share of the pixels without the object below which masks say nothing."""


def fit_occupancy(model: InverseModel, scene: Scene) -> None:
    """Empty a model outside of the visual hull of `scene`, where its masks determine one."""
    occupancy = model.nerf.occupancy
    if occupancy is not None:
        cells = hull_of(scene, model.config.occupancy)
        if cells is not None:
            occupancy.set(torch.from_numpy(cells))


def hull_of(scene: Scene, config: OccupancyConfig) -> Bool[ndarray, "x y z"] | None:
    """Return the cells of the scene's box that may hold the object, or None where the masks show nothing.

    Where the masks agree, a cell is kept if every view that sees it has a mask within `config.margin_px` of
    it. They agree if nearly each of their pixels shows such a cell. Where they do not, some are wrong, and a
    cell is kept if at most the share `config.dissent` of the views denies it. Either way a pixel of a mask
    that shows no cell that is kept keeps those that the fewest views deny, and one more layer of cells is
    added around all. Only the training views count; margins around their pictures show nothing.
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
    rays = [_rays(view.camera, mask, scene) for view, mask in zip(scene.train, masks, strict=True)]
    kept = denied == 0
    lonely = [_lonely(some, kept, low, size) for some in rays]
    if sum(map(len, lonely)) > _AGREED * sum(map(len, rays)):
        kept = share <= config.dissent
        lonely = [_lonely(some, kept, low, size) for some in rays]
    for some in lonely:
        kept |= _least_denied(some, share, low, size)
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


def _rays(camera: Camera, mask: Float32[ndarray, "height width"], scene: Scene) -> Rays:
    """Return the rays through the pixels of a mask, on their way through the scene's box."""
    rows, columns = np.nonzero(mask > _COVERED)
    lens = torch.tensor([camera.focal_x, camera.focal_y]), torch.tensor([camera.centre_x, camera.centre_y])
    pose = torch.from_numpy(camera.camera_to_world).float()
    place = torch.from_numpy(columns + 0.5).float(), torch.from_numpy(rows + 0.5).float()
    directions = pixel_directions(*place, *lens, pose)
    low, high = torch.tensor(scene.bounds_min), torch.tensor(scene.bounds_max)
    return clip_to_box(pose[:3, 3].expand_as(directions), directions, low, high, *scene.primary)


def _lonely(
    rays: Rays, kept: Bool[ndarray, "x y z"], low: Float[ndarray, "3"], size: Float[ndarray, "3"]
) -> Rays:
    """Return the rays that pass no cell that is kept, of those that pass the box."""
    corners = torch.from_numpy(low).float(), torch.from_numpy(low + kept.shape[0] * size).float()
    near, far = dispatch.stretch(rays, torch.from_numpy(kept.astype(np.uint8)), *corners, _step(size))
    return rays.select((rays.far > rays.near) & ~(far > near))


def _step(size: Float[ndarray, "3"]) -> float:
    """Return the distance of the points at which rays look for cells."""
    return 0.5 * float(size.min())


def _least_denied(
    rays: Rays, share: Float[ndarray, "x y z"], low: Float[ndarray, "3"], size: Float[ndarray, "3"]
) -> Bool[ndarray, "x y z"]:
    """Return for each ray the cells on its way that the fewest views deny."""
    least = np.zeros(share.shape, bool)
    for ray in range(len(rays)):
        near, far = float(rays.near[ray]), float(rays.far[ray])
        t = np.arange(near + 0.5 * _step(size), far, _step(size))[:, None]
        points = rays.origins[ray].numpy() + t * rays.directions[ray].numpy()
        cells = np.floor((points - low) / size).astype(int)
        cells = cells[((cells >= 0) & (cells < len(share))).all(axis=1)]
        denied = share[tuple(cells.T)]
        least[tuple(cells[denied <= denied.min(initial=np.inf)].T)] = True
    return least
