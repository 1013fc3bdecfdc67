"""Training pixels as batches of rays."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from scipy.ndimage import binary_dilation
from torch import Tensor

from flashcache.data.scene import Scene
from flashcache.errors import ConfigError, TrainingError
from flashcache.geometry.rays import Rays, clip_to_box, pixel_directions


@dataclass(frozen=True, kw_only=True, slots=True)
class PixelChoice:
    """The choice of the pixels of a training batch."""

    inside_share: float = 0.75
    """Share of rays through the dilated mask, 0..1; the rest fall anywhere. 0 is uniform, as in the paper."""
    dilation_px: int = 9
    """Width by which the mask is dilated for `inside_share`, pixels."""

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

    def __len__(self) -> int:
        return len(self.rays)

    def part(self, which: slice) -> "RayBatch":
        """Return some of the rays."""
        return RayBatch(
            self.rays.select(which),
            self.colour[which],
            self.coverage[which],
            self.light_index[which],
        )

    def over(self, background: Float[Tensor, "*rays 3"]) -> Float[Tensor, "rays 3"]:
        """Return the photograph composited over `background` in linear light."""
        coverage = self.coverage[:, None]
        return self.colour * coverage + (1.0 - coverage) * background


class TrainingPixels:
    """All training photographs of a scene on one device, ready to be drawn from."""

    def __init__(self, scene: Scene, choice: PixelChoice, device: torch.device) -> None:
        pictures, cameras, lights, starts, inside = [], [], [], [0], []
        for view in scene.train:
            for light, picture in view.images.items():
                if light not in scene.lights:
                    continue
                flat = torch.from_numpy(np.ascontiguousarray(picture, dtype=np.float32)).reshape(-1, 4)
                mask = binary_dilation(picture[..., 3] > 0.0, iterations=max(choice.dilation_px, 1))
                inside.append(torch.from_numpy(np.flatnonzero(mask)) + starts[-1])
                pictures.append(flat)
                cameras.append(view.camera)
                lights.append(scene.lights.index(light))
                starts.append(starts[-1] + len(flat))
        if not pictures:
            raise TrainingError(
                f"scene {scene.name!r} has no training photographs under "
                f"{', '.join(scene.lights) or 'any light'}"
            )
        self.choice = choice
        self.device = device
        self.scene = scene
        self.pixels = torch.cat(pictures).to(device)
        self.inside = torch.cat(inside).to(device)
        self.starts = torch.tensor(starts, device=device)
        self.width = torch.tensor([camera.width for camera in cameras], device=device)
        self.light = torch.tensor(lights, device=device)
        self.focal = torch.tensor(
            [[camera.focal_x, camera.focal_y] for camera in cameras], dtype=torch.float32, device=device
        )
        self.centre = torch.tensor(
            [[camera.centre_x, camera.centre_y] for camera in cameras], dtype=torch.float32, device=device
        )
        poses = np.stack([camera.camera_to_world for camera in cameras]).astype(np.float32)
        self.pose = torch.from_numpy(poses).to(device)

    def draw(self, num_rays: int, generator: torch.Generator) -> RayBatch:
        """Return a batch of pixels drawn with replacement; rays go through pixel centres."""
        num_inside = round(num_rays * self.choice.inside_share)

        def randint(high: int, count: int) -> Tensor:
            return torch.randint(high, (count,), generator=generator, device=self.device)

        index = torch.cat(
            [
                self.inside[randint(len(self.inside), num_inside)],
                randint(len(self.pixels), num_rays - num_inside),
            ]
        )
        # Shuffled, so that the first rays of a batch are an unbiased sample of it.
        return self.at(index[torch.randperm(num_rays, generator=generator, device=self.device)])

    def at(self, index: Int[Tensor, " rays"]) -> RayBatch:
        """Return the rays of pixels given by their position in the concatenated photographs."""
        image = torch.searchsorted(self.starts, index, right=True) - 1
        local = index - self.starts[image]
        columns = (local % self.width[image]).float() + 0.5
        rows = torch.div(local, self.width[image], rounding_mode="floor").float() + 0.5
        pose = self.pose[image]
        directions = pixel_directions(columns, rows, self.focal[image], self.centre[image], pose)
        values = self.pixels[index]
        rays = clip_to_scene(pose[:, :3, 3], directions, self.scene)
        return RayBatch(rays, values[:, :3], values[:, 3], self.light[image])


def clip_to_scene(
    origins: Float[Tensor, "rays 3"], directions: Float[Tensor, "rays 3"], scene: Scene
) -> Rays:
    """Return rays limited to the scene's box and to its near and far distance."""
    # Differs from the paper: rays also end at the box (docs/decisions/0019-small-departures.md).
    low = origins.new_tensor(scene.bounds_min)
    high = origins.new_tensor(scene.bounds_max)
    return clip_to_box(origins, directions, low, high, *scene.primary)
