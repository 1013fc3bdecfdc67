"""From a viewer's state to the pixels of its window: relighting, channels, and the sides of a comparison.

Pictures that only differ in how they are shown (exposure, tone curve, channel, split) are made once.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
from lambent_core.colour import srgb_from_linear
from lambent_relight import Camera, RelitPicture, Renderer, write_picture_exr
from lambent_relight.aovs import OBJECT_NAME
from lambent_relight.bundle.graphs import (
    NoCaches,
    PointMaterials,
    PrimaryHits,
    Rows,
    SecondaryHits,
    SurfaceCaches,
)
from numpy.typing import NDArray
from PIL import Image as PillowImage

from lambent.desktop.channels import RADIANCE, UNCERTAIN, graded, object_positions, shown_channel
from lambent.desktop.lights import Lights
from lambent.desktop.photographs import Photograph, fitted, resampled
from lambent.desktop.state import BACKDROPS, ViewerState

ANTIALIAS = 2
"""Fragments along a pixel's side, at rest; as `lambent relight`."""
_RAYS_AT_ONCE = 512
_KEPT_PICTURES = 4
_LINE_PX = 2


class SupersededError(Exception):
    """A picture was given up because another one is wanted."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Painted:
    """The pixels of a window."""

    image: NDArray[np.uint8]
    """sRGB, [height, width, 3], rows from the top."""
    legend: str
    """Meaning of dark and light, for channels that have one."""
    full: bool
    """Whether this is full quality; otherwise outlines are those of the mesh, without antialiasing."""


class Painter:
    """Paints states. One thread at a time may use it."""

    def __init__(self, renderer: Renderer, lights: Lights, photographs: list[Photograph]) -> None:
        """Prepare to paint; `renderer` must have baked transport (UnsupportedQuality).

        A renderer belongs to its last painter, and must not have made baked pictures before its first one.
        """
        self.renderer, self.lights, self.photographs = renderer, lights, photographs
        self.is_superseded: Callable[[], bool] = lambda: False
        """Asked while a new view's outline is made, which takes long; true gives it up (SupersededError)."""
        if not isinstance(renderer.caches, NoCaches | _Interruptible):
            renderer.caches = _Interruptible(renderer.caches)
        if isinstance(renderer.caches, _Interruptible):
            renderer.caches.is_superseded = lambda: self.is_superseded()
        renderer.baked()
        self._grid = renderer.bundle.uncertainty()
        self._pictures: dict[tuple[object, ...], RelitPicture] = {}
        self._full_views: list[tuple[bytes, float]] = []

    def knows_view(self, state: ViewerState) -> bool:
        """Return whether the view of `state` was painted in full lately, so that a full picture is quick."""
        return self._view_key(state) in self._full_views

    def camera(self, state: ViewerState) -> Camera:
        """Return the camera of `state`: its own, or the photograph's."""
        if state.comparison == "photograph":
            return fitted(self.photographs[state.photograph].camera, state.width, state.height)[0]
        return state.orbit.camera(state.width, state.height)

    def picture(self, state: ViewerState, light: int, *, full: bool = True) -> RelitPicture:
        """Return the relit picture of `state` under the environment `light`, without background."""
        camera = self.camera(state)
        turned = (state.rotate_deg, state.object_rotate_deg)
        key = (camera.key(), light, *turned, state.edit, state.indirect, full)
        if key not in self._pictures:
            made = self.renderer.render(
                camera,
                self.lights.environment(light),
                quality="baked",
                rotate_deg=state.rotate_deg,
                object_rotate_deg=state.object_rotate_deg,
                indirect=state.indirect,
                antialias=ANTIALIAS if full else 1,
                soft_edges=full,
                edit=state.edit,
            )
            while len(self._pictures) >= _KEPT_PICTURES:
                self._pictures.pop(next(iter(self._pictures)))
            self._pictures[key] = made
        return self._pictures[key]

    def paint(self, state: ViewerState, *, full: bool = True) -> Painted:
        """Return the pixels of the window; raises RelightError for an environment that cannot be used."""
        left, legend = self._side(state, state.light, full=full)
        encoded = left
        if state.comparison:
            column = round(state.split * state.width)
            if state.comparison == "environment":
                right, _ = self._side(state, state.other_light, full=full)
            else:
                right = self._photograph(state)
            encoded = np.concatenate([left[:, :column], right[:, column:]], axis=1)
            line = slice(max(column - _LINE_PX // 2, 0), column + _LINE_PX // 2)
            encoded[:, line] = 1.0
        if full:
            self._full_views = [*self._full_views[-2:], self._view_key(state)]
        pixels = np.round(np.float32(255.0) * encoded).astype(np.uint8)
        return Painted(image=np.ascontiguousarray(pixels), legend=legend, full=full)

    def save(self, state: ViewerState, stem: Path) -> list[Path]:
        """Write STEM.png, the window's picture in full quality, and STEM.exr, the left side's passes."""
        stem.parent.mkdir(parents=True, exist_ok=True)
        files = [stem.with_name(f"{stem.name}{suffix}") for suffix in (".png", ".exr")]
        PillowImage.fromarray(self.paint(state).image).save(files[0])
        name = self.renderer.bundle.manifest.name or OBJECT_NAME
        write_picture_exr(files[1], self.picture(state, state.light), object_name=name)
        return files

    def _view_key(self, state: ViewerState) -> tuple[bytes, float]:
        return (self.camera(state).key(), state.object_rotate_deg)

    def _side(self, state: ViewerState, light: int, *, full: bool) -> tuple[NDArray[np.float32], str]:
        """Return one side of the window, sRGB-encoded [height, width, 3], and the channel's legend."""
        picture = self.picture(state, light, full=full)
        if state.channel in RADIANCE:
            radiance = picture.rgb if state.channel == "final" else getattr(picture, state.channel)
            return self._over_backdrop(state, light, picture, radiance), ""
        camera = self.camera(state)
        image, legend = shown_channel(
            picture,
            state.channel,
            lambda: object_positions(
                camera.rays()[1], camera.camera_to_world[:3, 3], picture.distance, state.object_rotate_deg
            ),
            self._grid if state.channel.startswith(UNCERTAIN) else None,
        )
        backdrop = srgb_from_linear(np.array(BACKDROPS[state.backdrop] or BACKDROPS["grey"], np.float32))
        return image * picture.coverage + backdrop * (1.0 - picture.coverage), legend

    def _over_backdrop(
        self, state: ViewerState, light: int, picture: RelitPicture, radiance: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return graded radiance; it is mixed with a colour as shown, and with the light as radiance."""
        grade = partial(graded, exposure_ev=state.exposure_ev, tone_mapping=state.tone_mapping)
        colour = BACKDROPS[state.backdrop]
        if colour is not None:
            return _mixed(grade(radiance), srgb_from_linear(np.array(colour, np.float32)), picture.coverage)
        open_sky = (picture.coverage[..., 0] < 1.0).ravel()
        behind = np.zeros((open_sky.size, 3), np.float32)
        turned = self.lights.environment(light).rotated(state.rotate_deg)
        behind[open_sky] = turned.lookup(self.camera(state).rays()[1][open_sky])
        return grade(_mixed(radiance, behind.reshape(radiance.shape), picture.coverage))

    def _photograph(self, state: ViewerState) -> NDArray[np.float32]:
        """Return the photograph where its camera has it, graded like the rest, over the backdrop."""
        photograph = self.photographs[state.photograph]
        _, (rows, columns) = fitted(photograph.camera, state.width, state.height)
        size = (columns.stop - columns.start, rows.stop - rows.start)
        pixels = resampled(photograph.pixels(), *size)
        grade = partial(graded, exposure_ev=state.exposure_ev, tone_mapping=state.tone_mapping)
        colour = srgb_from_linear(np.array(BACKDROPS[state.backdrop] or BACKDROPS["grey"], np.float32))
        result = np.broadcast_to(colour, (state.height, state.width, 3)).astype(np.float32)
        result[rows, columns] = _mixed(grade(pixels[..., :3]), colour, pixels[..., 3:])
        return result


def _mixed(
    front: NDArray[np.float32], back: NDArray[np.float32], share: NDArray[np.float32]
) -> NDArray[np.float32]:
    return front * share + back * (np.float32(1.0) - share)


class _Interruptible(SurfaceCaches):
    """Asks for camera rays in small groups, and gives up between two of them."""

    def __init__(self, caches: SurfaceCaches) -> None:
        self._caches, self.name = caches, caches.name
        self.is_superseded: Callable[[], bool] = lambda: False

    def gbuffer(self, origin: Rows, direction: Rows) -> PrimaryHits:
        """Return what camera rays [ray, 3] see."""
        groups = []
        for start in range(0, max(len(origin), 1), _RAYS_AT_ONCE):
            if self.is_superseded():
                raise SupersededError
            some = slice(start, start + _RAYS_AT_ONCE)
            groups.append(self._caches.gbuffer(origin[some], direction[some]))
        names = [field.name for field in fields(PrimaryHits)]
        return PrimaryHits(**{name: np.concatenate([getattr(g, name) for g in groups]) for name in names})

    def secondary(self, origin: Rows, direction: Rows) -> SecondaryHits:
        """Return what secondary rays [ray, 3] hit."""
        return self._caches.secondary(origin, direction)

    def material(self, position: Rows) -> PointMaterials:
        """Return the surface properties at points [point, 3]."""
        return self._caches.material(position)
