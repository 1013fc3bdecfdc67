"""Training pixels as batches of rays."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int, Int64
from lambent_core.scene import Scene, View
from numpy import ndarray
from scipy.ndimage import binary_dilation
from torch import Tensor

from flashcache.encoding.occupancy import Occupancy
from flashcache.errors import ConfigError, TrainingError
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions
from flashcache.parallel.ranks import own_count, own_rows, whole_count

_CHUNK_PIXELS = 1 << 16
"""Pixels whose rays are made at once, where all are looked at."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PixelChoice:
    """The choice of the pixels of a training batch."""

    inside_share: float = 0.75
    """Share of rays through the dilated mask, 0..1; the rest fall anywhere. 0 is uniform, as in the paper."""
    dilation_px: int = 9
    """Width by which the mask is dilated for `inside_share`, pixels."""
    clipped: Literal["at_least", "exact"] = "exact"
    """Values at the end of a photograph's scale: the least that the true ones may be, or, as in the paper,
    values like all others."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.inside_share <= 1.0:
            raise ConfigError(f"inside_share must lie in 0..1, got {self.inside_share}")


@dataclass(frozen=True, slots=True)
class RayBatch:
    """Rays with their photographed colours."""

    rays: Rays
    colour: Float[Tensor, "rays 3"]
    """Linear Rec. 709, straight (not multiplied by coverage)."""
    coverage: Float[Tensor, " rays"]
    """Share of the pixel that the object covers."""
    light_index: Int[Tensor, " rays"]
    """Position among the lights of the scene, or the number of the photograph's turn (`Scene.turned`)."""
    clipped: Bool[Tensor, "rays 3"] | None = None
    """Channels of the colour that are known to be at least so bright; None: all are values like others."""

    def __len__(self) -> int:
        return len(self.rays)

    def part(self, which: slice) -> "RayBatch":
        """Return some of the rays."""
        return RayBatch(
            self.rays.select(which),
            self.colour[which],
            self.coverage[which],
            self.light_index[which],
            None if self.clipped is None else self.clipped[which],
        )

    def over(self, background: Float[Tensor, "*rays 3"]) -> Float[Tensor, "rays 3"]:
        """Return the photograph composited over `background` in linear light."""
        coverage = self.coverage[:, None]
        return self.colour * coverage + (1.0 - coverage) * background


class TrainingPixels:
    """All training photographs of a scene on one device, ready to be drawn from.

    A position counts through the pixels of all frames, row by row; what a frame shows around its picture
    (`View.margins`) counts too, as pixels without the object, although it is not stored.
    """

    def __init__(
        self,
        scene: Scene,
        choice: PixelChoice,
        device: torch.device,
        occupancy: Occupancy | None = None,
    ) -> None:
        """With `occupancy`, only pixels are drawn whose rays meet a cell that may hold something."""
        shown = [
            (view, light, picture)
            for view in scene.train
            for light, picture in view.images.items()
            if light in scene.lights
        ]
        if not shown:
            raise TrainingError(
                f"scene {scene.name!r} has no training photographs under "
                f"{', '.join(scene.lights) or 'any light'}"
            )
        views, cameras = [view for view, _, _ in shown], [view.camera for view, _, _ in shown]
        self.choice = choice
        self.device = device
        self.scene = scene
        sizes = [_frame_size(view) for view in views]
        starts = np.cumsum([0, *(width * height for width, height in sizes)])
        stored = np.cumsum([0, *(camera.width * camera.height for camera in cameras)])
        inside = [
            torch.from_numpy(_inside(view, picture, choice.dilation_px)) + start
            for (view, _, picture), start in zip(shown, starts[:-1].tolist(), strict=True)
        ]
        flat = [
            torch.from_numpy(np.ascontiguousarray(picture, dtype=np.float32)).reshape(-1, 4)
            for _, _, picture in shown
        ]
        self.pixels = torch.cat(flat).to(device)
        self.clipped = None
        if choice.clipped == "at_least":
            flags = [_clipped(view, light) for view, light, _ in shown]
            self.clipped = torch.cat(flags).to(device)
        self.inside = torch.cat(inside).to(device)
        self.num_positions = int(starts[-1])
        self.starts = torch.from_numpy(starts).to(device)
        self.stored = torch.from_numpy(stored).to(device)
        self.frame_width = torch.tensor([width for width, _ in sizes], device=device)
        self.size = torch.tensor([[camera.width, camera.height] for camera in cameras], device=device)
        self.offset = torch.tensor([[view.margins.left, view.margins.top] for view in views], device=device)
        turn_of = {view.name: number for number, view in enumerate(scene.turned, start=1)}
        indices = [turn_of.get(view.name, scene.lights.index(light)) for view, light, _ in shown]
        self.light = torch.tensor(indices, device=device)
        self.focal = torch.tensor(
            [[camera.focal_x, camera.focal_y] for camera in cameras], dtype=torch.float32, device=device
        )
        self.centre = torch.tensor(
            [[camera.centre_x, camera.centre_y] for camera in cameras], dtype=torch.float32, device=device
        )
        poses = np.stack([camera.camera_to_world for camera in cameras]).astype(np.float32)
        self.pose = torch.from_numpy(poses).to(device)
        corners = (scene.bounds_min, scene.bounds_max)
        self.low, self.high = (torch.tensor(corner, dtype=torch.float32, device=device) for corner in corners)
        self.meeting = None if occupancy is None else self._meeting(occupancy)

    def draw(self, num_rays: int, generator: torch.Generator) -> RayBatch:
        """Return a batch of pixels drawn with replacement; rays go through pixel centres.

        Where ranks divide the batch, it is this rank's part of it.
        """
        num_rays = whole_count(own_count(num_rays))
        if self.meeting is not None:
            drawn = torch.randint(len(self.meeting), (num_rays,), generator=generator, device=self.device)
            return self.at(self.meeting[own_rows(drawn)])
        num_inside = round(num_rays * self.choice.inside_share)

        def randint(high: int, count: int) -> Tensor:
            return torch.randint(high, (count,), generator=generator, device=self.device)

        index = torch.cat(
            [
                self.inside[randint(len(self.inside), num_inside)],
                randint(self.num_positions, num_rays - num_inside),
            ]
        )
        # Shuffled, so that the first rays of a batch are an unbiased sample of it.
        shuffled = index[torch.randperm(num_rays, generator=generator, device=self.device)]
        return self.at(own_rows(shuffled))

    def photograph_of(self, index: Int[Tensor, " rays"]) -> Int[Tensor, " rays"]:
        """Return the number of the photograph in which each position lies."""
        return torch.searchsorted(self.starts, index, right=True) - 1

    def at(self, index: Int[Tensor, " rays"]) -> RayBatch:
        """Return the rays of pixels given by their position in the concatenated frames."""
        image = self.photograph_of(index)
        local = index - self.starts[image]
        width = self.frame_width[image]
        column = local % width - self.offset[image, 0]
        row = torch.div(local, width, rounding_mode="floor") - self.offset[image, 1]
        pose = self.pose[image]
        directions = pixel_directions(
            column.float() + 0.5, row.float() + 0.5, self.focal[image], self.centre[image], pose
        )
        place, stored = self._places(image, column, row)
        values = self.pixels[place] * stored[:, None]
        clipped = None if self.clipped is None else self.clipped[place] & stored[:, None]
        # Differs from the paper: rays also end at the box (docs/decisions/0019-small-departures.md).
        rays = clip_to_box(pose[:, :3, 3], directions, self.low, self.high, *self.scene.primary)
        return RayBatch(rays, values[:, :3], values[:, 3], self.light[image], clipped)

    def _meeting(self, occupancy: Occupancy) -> Int[Tensor, " pixels"]:
        """Return the positions of the stored pixels whose rays meet a cell that may hold something."""
        parts = []
        for image, (width, height) in enumerate(self.size.tolist()):
            rows, columns = torch.meshgrid(
                torch.arange(height, device=self.device),
                torch.arange(width, device=self.device),
                indexing="ij",
            )
            left, top = self.offset[image].tolist()
            inside = (rows + top) * self.frame_width[image] + columns + left + self.starts[image]
            index = inside.reshape(-1)
            for some in index.split(_CHUNK_PIXELS):
                narrow = occupancy.narrowed(self.at(some).rays)
                parts.append(some[narrow.far > narrow.near])
        meeting = torch.cat(parts)
        if not len(meeting):
            raise TrainingError(
                f"no photograph of scene {self.scene.name!r} shows a cell that may hold the object; look at "
                "the masks (lambent masks --edit), or train with --set model.occupancy.cells=0"
            )
        return meeting

    def _places(
        self, image: Int[Tensor, " rays"], column: Int[Tensor, " rays"], row: Int[Tensor, " rays"]
    ) -> tuple[Int[Tensor, " rays"], Bool[Tensor, " rays"]]:
        """Return the places of pixels among the stored ones, and which are stored; others have any place."""
        width, height = self.size[image].unbind(dim=-1)
        stored = (column >= 0) & (row >= 0) & (column < width) & (row < height)
        return self.stored[image] + torch.where(stored, row * width + column, 0), stored


def _frame_size(view: View) -> tuple[int, int]:
    """Return width and height of a view's picture with its margins."""
    margins, camera = view.margins, view.camera
    return margins.left + camera.width + margins.right, margins.top + camera.height + margins.bottom


def _clipped(view: View, light: str) -> Bool[Tensor, "pixels 3"]:
    """Return which channels of a view's pixels are at the end of the scale."""
    if light in view.clipped:
        return torch.tensor(view.clipped[light]).reshape(-1, 3)
    return torch.zeros(view.camera.width * view.camera.height, 3, dtype=torch.bool)


def _inside(
    view: View, picture: Float32[ndarray, "height width 4"], dilation_px: int
) -> Int64[ndarray, " n"]:
    """Return the positions in the frame of the pixels in and around the mask."""
    around = max(dilation_px, 1)
    margins = view.margins
    left, top = min(around, margins.left), min(around, margins.top)
    room = ((top, min(around, margins.bottom)), (left, min(around, margins.right)))
    mask = binary_dilation(np.pad(picture[..., 3] > 0.0, room), iterations=around)
    rows, columns = np.nonzero(mask)
    return (rows + margins.top - top) * _frame_size(view)[0] + columns + margins.left - left
