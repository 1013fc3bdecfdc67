"""The six captures: what stands where, in which light, and how it is photographed."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mitsuba as mi
import numpy as np
from make_sample_scene import emitter

from tabletop import supports
from tabletop.cameras import Shot, around, between, look_at, phone, sixteen
from tabletop.distance import Surface, surface
from tabletop.lights import light_image
from tabletop.objects import THINGS, Thing


@dataclass(frozen=True, kw_only=True, slots=True)
class Capture:
    """One capture of the suite."""

    name: str
    about: str
    thing: str
    around: Callable[[], dict[str, Any]]
    light: str
    seed: int
    distance: float
    """Of the camera from the object's middle, in sizes of the object."""
    grey: float = 0.17
    auto_exposure: bool = False
    k1: float = 0.0
    k2: float = 0.0
    upright: tuple[int, ...] = field(default=())
    """Every view whose number modulo 10 is among these is upright, with EXIF orientation 6 or 8."""
    turntable: bool = False


CAPTURES = {
    capture.name: capture
    for capture in (
        Capture(
            name="carpet",
            about="a painted elephant on wheels on a patterned carpet, with the sun's shadow",
            thing="elephant", around=supports.carpet, light="sunny_room", seed=1, distance=1.7,
        ),
        Capture(
            name="sheet",
            about="a glazed mug on a printed sheet on a table",
            thing="mug", around=supports.sheet, light="overcast_room", seed=2, distance=1.9,
            auto_exposure=True, upright=(2, 3, 7), grey=0.22,
        ),
        Capture(
            name="table",
            about="an enamel teapot on a wooden table with clutter at the pictures' edges",
            thing="teapot", around=supports.table, light="kitchen", seed=3, distance=1.6,
            auto_exposure=True, k1=-0.045, k2=0.012,
        ),
        Capture(
            name="white",
            about="a white porcelain rabbit on white paper",
            thing="rabbit", around=supports.white, light="overcast_room", seed=4, distance=1.8, grey=0.34,
            upright=(1, 2, 3, 4, 5, 6),
        ),
        Capture(
            name="glossy",
            about="a black lacquered cat on dark cloth",
            thing="cat", around=supports.cloth, light="studio_room", seed=5, distance=1.75,
            grey=0.08, k1=0.02,
        ),
        Capture(
            name="turntable",
            about="a tin robot that turns on a plate before a room that stands still",
            thing="robot", around=supports.room, light="studio_room", seed=6, distance=1.8, turntable=True,
        ),
    )
}  # fmt: skip


class Stage:
    """A capture that can be photographed: its object, surroundings and lights."""

    def __init__(self, capture: Capture, cells: int) -> None:
        """Build the object with `cells` cells along its longest side."""
        self.capture = capture
        self.thing: Thing = THINGS[capture.thing]
        self.surface: Surface = surface(self.thing.distance, self.thing.low, self.thing.high, cells)
        colour, roughness, metalness = self.thing.paint(self.surface.positions, self.surface.normals)
        self.paints = {
            "vertex_color": np.clip(colour, 0.004, 0.95),
            "vertex_rough": np.clip(roughness, 0.08, 1.0),
            "vertex_metal": metalness,
        }
        self.surroundings = capture.around()
        self.light = light_image(capture.light)
        self._built: tuple[float, tuple[mi.Scene, mi.Shape]] | None = None

    def object(self, turn_deg: float = 0.0) -> "mi.Mesh":
        """Return the object's mesh, turned about z."""
        attribute = {
            key: {"type": "mesh_attribute", "name": f"vertex_{name}"}
            for key, name in (("base_color", "color"), ("roughness", "rough"), ("metallic", "metal"))
        }
        return supports.triangles(
            "object",
            self.surface.positions,
            self.surface.faces,
            {"type": "principled", "specular": 0.5, **attribute},
            normals=self.surface.normals,
            paints=self.paints,
            turn_deg=turn_deg,
        )

    def scene(self, turn_deg: float = 0.0) -> tuple["mi.Scene", "mi.Shape"]:
        """Return the whole scene and the object in it."""
        if self._built is None or self._built[0] != turn_deg:
            thing = self.object(turn_deg)
            turning = supports.disc(turn_deg) if self.capture.turntable else {}
            light = emitter(self.light, rows=1025)
            parts = {"type": "scene", "light": light, "object": thing, **self.surroundings, **turning}
            self._built = (turn_deg, (mi.load_dict(parts), thing))
        return self._built[1]

    def alone(self, light: np.ndarray) -> tuple["mi.Scene", "mi.Shape"]:
        """Return the object alone under a light, as it is relit: on nothing."""
        thing = self.object()
        return mi.load_dict({"type": "scene", "light": emitter(light), "object": thing}), thing

    def shots(self, num_views: int, size: int) -> list[Shot]:
        """Return the photographs to take."""
        capture, lens = self.capture, {"k1": self.capture.k1, "k2": self.capture.k2}
        if capture.turntable:
            camera = phone(size, self._tripod(32.0), upright=True)
            return [
                Shot(camera=camera, orientation=6, turn_deg=360.0 * k / num_views) for k in range(num_views)
            ]
        shots = []
        for k, pose in enumerate(around(num_views, self.thing.middle, self._far(), capture.seed)):
            upright = k % 10 in capture.upright
            camera = phone(size, pose, upright=upright, **lens)
            shots.append(Shot(camera=camera, orientation=(8 if k % 20 == 7 else 6) if upright else 1))
        return shots

    def few(self, num_views: int) -> list[int]:
        """Return which sixteen of the photographs make a capture of their own."""
        if self.capture.turntable and num_views > 16:
            return [int((k + 0.5) * num_views / 16) for k in range(16)]
        return sixteen(num_views)

    def held_out(self, num_views: int, size: int) -> list[Shot]:
        """Return the views that are not photographed but scored; without distortion."""
        if self.capture.turntable:
            turns = [360.0 * (k + 0.37) / num_views for k in range(num_views)]
            heights = (32.0, 46.0)
            poses = [self._tripod(heights[k % 2]) for k in range(num_views)]
        else:
            turns = [0.0] * num_views
            poses = between(num_views, self.thing.middle, self._far(), self.capture.seed)
        return [
            Shot(camera=phone(size, pose, upright=False), turn_deg=turn)
            for pose, turn in zip(poses, turns, strict=True)
        ]

    def _far(self) -> float:
        return self.capture.distance * self.thing.size

    def _tripod(self, elevation_deg: float) -> np.ndarray:
        high = np.radians(elevation_deg)
        back = np.array([np.cos(high), 0.0, np.sin(high)])
        return look_at(self.thing.middle + self._far() * back, self.thing.middle, 0.6)
