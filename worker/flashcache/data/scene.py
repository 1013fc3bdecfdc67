"""A captured object in memory: cameras, photographs, and ground truth where there is any.

World coordinates are right-handed with z up. Camera axes are x right, y up, looking along -z. Pixel centres
lie at half-integer coordinates. Pictures are linear Rec. 709 with straight alpha. Numpy only.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from jaxtyping import Bool, Float32, Float64
from numpy import ndarray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Camera:
    """A pinhole camera."""

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    focal_x: float
    """Pixels."""
    focal_y: float
    """Pixels."""
    centre_x: float
    """Column of the optical axis in pixels; `width / 2` is the middle of the picture."""
    centre_y: float
    """Row of the optical axis in pixels."""
    camera_to_world: Float64[ndarray, "4 4"]
    """Rigid motion from camera axes to the world, scene units."""

    @property
    def position(self) -> Float64[ndarray, "3"]:
        """Return the position of the camera in world coordinates."""
        return self.camera_to_world[:3, 3]

    def resized(self, width: int, height: int) -> "Camera":
        """Return the same camera with a picture of `width` by `height` pixels."""
        return Camera(
            width=width,
            height=height,
            focal_x=self.focal_x * width / self.width,
            focal_y=self.focal_y * height / self.height,
            centre_x=self.centre_x * width / self.width,
            centre_y=self.centre_y * height / self.height,
            camera_to_world=self.camera_to_world,
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class Margins:
    """The part of a frame that was cut off around the object, in pixels of what is left of it."""

    left: int = 0
    top: int = 0
    right: int = 0
    bottom: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class View:
    """One camera with its photographs."""

    name: str
    """Unique inside the scene; the folder name of its predictions."""
    camera: Camera
    """The camera of the pictures: where they are cut to the object, so is this. Views differ in size."""
    images: Mapping[str, Float32[ndarray, "height width 4"]]
    """Picture by light: linear radiance in three channels, straight alpha in the fourth."""
    truth: Mapping[str, Float32[ndarray, "height width _"]] = field(default_factory=dict)
    """Ground truth by kind: `albedo` [H, W, 4] linear with straight alpha, `normal` [H, W, 4] world xyz (zero
    where alpha is) with alpha, `roughness` (perceptual) and `metallic` [H, W, 1], `distance` [H, W, 1] in
    scene units, 0 where nothing was hit."""
    clipped: Mapping[str, Bool[ndarray, "height width 3"]] = field(default_factory=dict)
    """Channels of a picture that were at the end of its scale, by light: the true value is at least the
    stored one. Lights whose picture has none are left out."""
    margins: Margins = field(default_factory=Margins)
    """What the frame shows around the pictures: nothing of the object, so it is not kept."""
    light_turn: Float64[ndarray, "3 3"] | None = None
    """Rotation from world directions to the frame in which the light stands still; None where it stands still
    in the world."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scene:
    """Everything the method needs to know about one capture."""

    name: str
    lights: tuple[str, ...]
    """Lights of the training photographs; position in this tuple is the light index everywhere."""
    relight_lights: tuple[str, ...] = ()
    """Lights that only test views show: truth for relighting, never trained on."""
    train: tuple[View, ...]
    test: tuple[View, ...]
    bounds_min: tuple[float, float, float]
    """Corner of the box around the object, scene units."""
    bounds_max: tuple[float, float, float]
    primary: tuple[float, float]
    """Near and far distance along camera rays, scene units."""
    secondary: tuple[float, float]
    """Near and far distance along rays that leave a surface, scene units."""
    contraction_radius: float
    """Distance from the origin at which space begins to be contracted, scene units."""

    @property
    def turned(self) -> tuple[View, ...]:
        """Return the views whose light has a turn; number k has light index k + 1 (0 is the reference)."""
        return tuple(view for view in (*self.train, *self.test) if view.light_turn is not None)


def evenly_spaced(views: tuple[View, ...], count: int) -> tuple[View, ...]:
    """Return at most `count` of `views` at equal strides, all of them for 0."""
    return views[:: max(1, len(views) // count)][:count] if count else views
