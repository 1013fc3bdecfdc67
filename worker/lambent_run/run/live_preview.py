"""Pictures of the model while it trains: the object turns a step with each.

Their size is what their share of the time allows: a slow machine makes smaller ones, never rarer ones than
`LONGEST_S`. They draw no random numbers, so that a run is the same with and without them.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from flashcache.evaluation.gbuffer import CHUNK_RAYS, cache_picture, camera_rays
from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.rays import pixel_directions
from flashcache.physical.model import InverseModel
from jaxtyping import Float32, Float64
from lambent_capture.scenes.extent import looked_at_point
from lambent_core.reporter import Reporter
from lambent_core.scene import Camera, Scene
from lambent_relight.cameras import look_at, position_around
from numpy import ndarray
from torch import Tensor

from lambent_run.report import figures
from lambent_run.report.predictions import over_white

NAME = "turning_{task}"
"""Name of the previews of a task; bundles leave them out, for they depend on the machine's speed."""
INTERVAL_S = 10.0
LONGEST_S = 25.0
"""Between two previews, where even the smallest ones cost more than their share at `INTERVAL_S`."""
SHARE = 0.04
"""Of the time of training that goes into previews."""
SIDES = (24, 192)
"""Smallest and largest side in pixels."""
FIRST_SIDE = 40
STEP_DEG = 15.0
WIDE_GAP_DEG = 100.0
"""Where photographs leave a gap this wide in the circle, the camera swings instead of going round."""
_MARGIN = 1.1
_GROWTH = 1.6
"""At most by which a side grows from one preview to the next: one measured time may be a lucky one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Orbit:
    """Where the camera of previews stands: at the height and distance of the photographs."""

    target: tuple[float, float, float]
    distance: float
    """Scene units."""
    elevation_deg: float
    tangent: float
    """Of half the field of view."""
    arc_deg: tuple[float, float] | None
    """Between which azimuths photographs were taken; None: all around."""

    @classmethod
    def around(cls, scene: Scene) -> "Orbit":
        """Return the orbit of a capture around the point that its photographs show in their middle."""
        cameras = [view.camera for view in scene.train or scene.test]
        target = seen_middle(cameras, np.array(scene.bounds_min), np.array(scene.bounds_max))
        offsets = np.array([camera.position for camera in cameras]) - target
        level = np.hypot(offsets[:, 0], offsets[:, 1])
        tangents = [0.5 * max(camera.width, camera.height) / camera.focal_x for camera in cameras]
        return cls(
            target=(float(target[0]), float(target[1]), float(target[2])),
            distance=float(np.median(np.linalg.norm(offsets, axis=1))),
            elevation_deg=float(np.degrees(np.median(np.arctan2(offsets[:, 2], level)))),
            tangent=_MARGIN * float(np.median(tangents)),
            arc_deg=photographed_arc(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0]))),
        )

    def azimuth_deg(self, number: int) -> float:
        """Return the azimuth of preview `number`, from 0."""
        if self.arc_deg is None:
            return number * STEP_DEG
        first, last = self.arc_deg
        steps = max(1, round((last - first) / STEP_DEG))
        place = number % (2 * steps)
        return first + (last - first) * min(place, 2 * steps - place) / steps

    def camera(self, number: int, side: int) -> Camera:
        """Return the camera of preview `number`, with `side` x `side` pixels."""
        position = position_around(self.target, self.distance, self.azimuth_deg(number), self.elevation_deg)
        focal = 0.5 * side / self.tangent
        return Camera(
            width=side,
            height=side,
            focal_x=focal,
            focal_y=focal,
            centre_x=0.5 * side,
            centre_y=0.5 * side,
            camera_to_world=look_at(position.tolist(), self.target),
        )


def seen_middle(
    cameras: Sequence[Camera], low: Float64[ndarray, "3"], high: Float64[ndarray, "3"]
) -> Float64[ndarray, "3"]:
    """Return the point nearest to the rays through the middles of all frames, limited to the box.

    `low` and `high` are the corners of the box; all are world coordinates in scene units. A frame that was
    cut to the object has it in its middle, wherever the object is in the box. Returns the middle of the box
    where the rays are parallel.
    """
    directions = pixel_directions(
        torch.tensor([0.5 * camera.width for camera in cameras], dtype=torch.float64),
        torch.tensor([0.5 * camera.height for camera in cameras], dtype=torch.float64),
        torch.tensor([(camera.focal_x, camera.focal_y) for camera in cameras], dtype=torch.float64),
        torch.tensor([(camera.centre_x, camera.centre_y) for camera in cameras], dtype=torch.float64),
        torch.from_numpy(np.stack([camera.camera_to_world for camera in cameras])),
    )
    point = looked_at_point(np.stack([camera.position for camera in cameras]), directions.numpy())
    return (low + high) / 2.0 if point is None else np.clip(point, low, high)


def photographed_arc(azimuths_deg: ndarray) -> tuple[float, float] | None:
    """Return the first and last azimuth, degrees, of the arc with all photographs; None if it is a circle."""
    around = np.sort(np.mod(azimuths_deg, 360.0))
    gaps = np.diff(np.append(around, around[0] + 360.0))
    widest = int(gaps.argmax())
    if gaps[widest] < WIDE_GAP_DEG:
        return None
    first = float(around[(widest + 1) % len(around)])
    return first, first + 360.0 - float(gaps[widest])


@dataclass(kw_only=True, slots=True)
class LivePreview:
    """Makes the previews of one task."""

    orbit: Orbit
    reporter: Reporter
    task: str
    clock: Callable[[], float] = time.monotonic
    side: int = FIRST_SIDE
    number: int = 0
    due: float = field(default=0.0)
    """When the next one is made, on `clock`: the first at once, so that there is something to see."""
    seconds: float = 0.0
    """Spent on previews."""
    given_up: bool = False
    """Whether one could not be made."""

    def attempt(self, model: InverseModel, step: int) -> None:
        """Show the model as `show` does, until one preview fails: a picture is not worth a training."""
        if self.given_up:
            return
        try:
            self.show(model)
        except Exception as error:
            self.given_up = True
            self.reporter.log("previews.failed", step=step, reason=repr(error)[:200])

    def tell(self) -> None:
        """Log how many previews were made, and what they cost."""
        if not self.given_up:
            self.reporter.log("previews.made", number=self.number, seconds=round(self.seconds, 3))

    def show(self, model: InverseModel) -> None:
        """Make a preview of the model in its training light, if one is due."""
        began = self.clock()
        if began < self.due:
            return
        picture = turned_picture(model, self.orbit.camera(self.number, self.side))
        self.reporter.preview(NAME.format(task=self.task), figures.png(picture, max_side=SIDES[1]))
        self.number += 1
        self._plan(self.clock() - began)

    def _plan(self, cost_s: float) -> None:
        """Choose side and time of the next preview from the cost of this one."""
        self.seconds += cost_s
        interval = min(max(INTERVAL_S, cost_s / SHARE), LONGEST_S)
        self.due = self.clock() + interval
        factor = (SHARE * INTERVAL_S / max(cost_s, 1e-6)) ** 0.5
        self.side = int(np.clip(self.side * min(factor, _GROWTH), *SIDES))


def turned_picture(model: InverseModel, camera: Camera) -> Float32[ndarray, "height width 3"]:
    """Return what the NeRF cache shows under the first training light, sRGB-encoded over white."""
    device = next(model.parameters()).device
    rays = camera_rays(model, camera, device)
    values = torch.zeros(len(rays), 4, device=device)
    hits = (rays.far > rays.near).nonzero()[:, 0]

    def fill(some: Tensor) -> None:
        colour, opacity = cache_picture(model, rays.select(some), 0)
        values[some] = torch.cat([colour, opacity[:, None]], dim=-1)

    on_all_cores(fill, hits.split(CHUNK_RAYS) if len(hits) else (), device)
    rgba = values.reshape(camera.height, camera.width, 4).nan_to_num().cpu().numpy()
    opacity = np.clip(rgba[..., 3:], 0.0, 1.0)
    straight = np.maximum(rgba[..., :3], 0.0) / np.maximum(opacity, 1e-3)
    return over_white(np.concatenate([straight, opacity], axis=-1)).astype(np.float32)
