"""Orders of pictures, as users write them, as the server keeps them and as the renderer reads them.

Every setting is declared here once, with its range, default and help text, for commands, REST bodies,
manifests and Python.
"""

import re
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError


def _whole(value: Any) -> Any:
    """Return an int for an integral float, which JSON Schema accepts as integer, and for a numpy integer."""
    if isinstance(value, float) and value.is_integer():
        return int(value)
    return int(value) if hasattr(value, "__index__") and not isinstance(value, bool) else value


WHOLE = BeforeValidator(_whole)


def _word(value: Any) -> Any:
    """Return a whole number as a word: `bounces=3` is "3"."""
    return str(value) if isinstance(value, int) and not isinstance(value, bool) else value


def safe_name(name: str) -> str:
    """Return `name` converted into a single path part that is valid on every system."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".-")[:64] or "_"


class Wanted(BaseModel):
    """A part of a request: unknown fields are refused, and no value is converted."""

    model_config = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)


Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")]
_WORDS = "a name of up to 64 letters, digits, '.', '_' and '-'"
Entry = TypeVar("Entry")
Entries = Annotated[Sequence[Entry], Field(min_length=1, max_length=1000)]
ViewName = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")]
PictureName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$", description=_WORDS)]
Identifier = Annotated[str, Field(pattern="^[a-z0-9_]{1,64}$")]
Angle = Annotated[float, Field(ge=-36000.0, le=36000.0)]
Side = Annotated[int, Field(ge=0, le=16384), WHOLE]
Finite = Annotated[float, Field(ge=-1e9, le=1e9)]
Positive = Annotated[float, Field(ge=1e-6, le=1e6)]
Bounces = Annotated[
    Literal["auto", "adapted", "baked", "transport", "one", "1", "2", "3", "4", "5", "6", "7", "8"],
    BeforeValidator(_word),
]
Occlusion = Literal["auto", "mesh", "cache"]
Quality = Literal["preview", "baked", "refined"]
ToneMapping = Literal["linear", "neutral", "aces", "agx"]
Axes = Literal["blender", "threejs", "mitsuba", "skylibs"]
Layout = Literal[
    "auto",
    "latlong",
    "angular",
    "mirror-ball",
    "cross-horizontal",
    "cross-vertical",
    "strip-horizontal",
    "strip-vertical",
    "cube",
]
"""How a file shows a sphere; "auto" is what it states, or else what its size says."""
Pass = Literal[
    "direct",
    "indirect",
    "diffuse",
    "specular",
    "standard_error",
    "visibility",
    "albedo",
    "normal",
    "perceptual_roughness",
    "metalness",
    "depth",
    "cryptomatte",
]


class RenderMaterial(Wanted):
    """Changes to the bundle's material."""

    albedo_gain: Annotated[
        list[Positive], Field(min_length=3, max_length=3, default_factory=lambda: [1.0, 1.0, 1.0])
    ]
    """Factors on the albedo, red, green, blue."""
    albedo: (
        Annotated[list[Annotated[float, Field(ge=0.0, le=1.0)]], Field(min_length=3, max_length=3)] | None
    ) = None
    """Linear albedo instead of the object's own."""
    roughness_scale: Annotated[float, Field(ge=0.0, le=1e6)] = 1.0
    """Factor on perceptual roughness."""


class RenderAsset(Wanted):
    """A bundle in one material and pose."""

    name: PictureName | None = None
    """Default: the bundle's id."""
    bundle_id: Identifier
    material: Annotated[RenderMaterial, Field(default_factory=RenderMaterial)]
    object_rotate_deg: Angle = 0.0
    """Rotates the object, not its light, about +z."""

    @property
    def called(self) -> str:
        """Return the name."""
        return self.name or self.bundle_id


class EnvironmentInput(Wanted):
    """How the file of an environment map is read."""

    axes: Axes = "blender"
    """Convention of the map; "blender" is ours."""
    layout: Layout = "auto"
    """How the file shows the sphere; "auto": as it states, else by its size."""
    mend: bool = False
    """Whether NaN, negative and infinite values are replaced; otherwise they are an error."""
    sun_clamp: Annotated[float, Field(ge=0.0, le=1e30)] = 0.0
    """Largest radiance of a channel; 0 keeps everything."""


class RenderEnvironment(EnvironmentInput):
    """An environment and how it is to be used."""

    name: PictureName | None = None
    """Default: the environment's own."""
    environment_id: Identifier
    rotate_deg: Angle = 0.0
    """Rotates the light about +z."""

    @property
    def called(self) -> str:
        """Return the name."""
        return self.name or self.environment_id


class RenderCamera(Wanted):
    """A pinhole camera, as in cameras.json of a bundle."""

    name: ViewName
    width: Annotated[int, Field(ge=1, le=16384), WHOLE]
    height: Annotated[int, Field(ge=1, le=16384), WHOLE]
    focal_x: Annotated[float, Field(gt=0.0, le=1e9)]
    focal_y: Annotated[float, Field(gt=0.0, le=1e9)]
    centre_x: Finite
    centre_y: Finite
    camera_to_world: Annotated[list[Finite], Field(min_length=16, max_length=16)]


UNCLEAR = "cameras_unclear"
"""Type of the error for cameras that no schema of single fields can refuse."""


class RenderCameras(Wanted):
    """Some cameras; exactly one of turntable, views, all_views and poses selects them."""

    name: Annotated[str, Field(pattern=r"^([A-Za-z0-9_][A-Za-z0-9._-]{0,63})?$", description=_WORDS)] = ""
    """Prefix of the cameras' names."""
    turntable: Annotated[int, Field(ge=0, le=10_000), WHOLE] = 0
    """This many cameras evenly around the object."""
    elevation_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    radius: Positive | None = None
    field_of_view_deg: Annotated[float, Field(ge=0.1, le=179.0)] | None = None
    start_deg: Angle = 0.0
    views: Annotated[list[ViewName], Field(max_length=10_000, default_factory=list)]
    """Names of cameras of the bundle."""
    all_views: bool = False
    poses: Annotated[list[RenderCamera], Field(max_length=10_000, default_factory=list)]
    size: Side = 0
    """Longer side in pixels; 0 keeps the size."""

    @field_validator("elevation_deg", "radius", "field_of_view_deg", "start_deg")
    @classmethod
    def _check_place(cls, value: float | None, info: ValidationInfo) -> float | None:
        default = cls.model_fields[str(info.field_name)].default
        if value != default and info.data.get("turntable") == 0:
            raise PydanticCustomError(UNCLEAR, "this places a turntable and has no meaning here")
        return value

    @model_validator(mode="after")
    def _check_source(self) -> "RenderCameras":
        if bool(self.turntable) + bool(self.views) + self.all_views + bool(self.poses) != 1:
            raise PydanticCustomError(
                UNCLEAR, "exactly one of turntable, views, all_views and poses is needed"
            )
        return self


class RenderSettings(Wanted):
    """How a picture is made and shown.

    Exposure, tone mapping and background only change how a picture is shown; any other setting renders anew.
    """

    model_config = ConfigDict(frozen=True)

    quality: Quality = "refined"
    """Baked transport (immediate, without noise) or Monte Carlo."""
    spp: Annotated[int, Field(ge=2, le=65536), WHOLE] = 64
    """Light directions per pixel."""
    until_stderr: Annotated[float, Field(ge=0.0, le=0.999)] = 0.0
    """Continue until the mean standard error is this share of the mean radiance, with more directions where
    there is more noise; 0: do not."""
    antialias: Annotated[int, Field(ge=1, le=8), WHOLE] = 2
    """Rays per pixel along each side, at the object."""
    indirect: bool = True
    """Whether indirect light is included."""
    bounces: Bounces = "auto"
    """Source of indirect light in refined pictures (auto: an adapted cache, else baked transport, diffusely
    reflected in part as it was baked), or how often light may be reflected, as random paths: 1 is direct
    light alone."""
    occlusion: Occlusion = "auto"
    """What is in the way of light in refined pictures: the mesh or the fast cache; auto: the mesh where the
    bundle has baked transport, but with an adapted cache what that cache sees."""
    denoise: bool = False
    """Smooth what noise is left in a refined picture, guided by albedo and normals; not for measuring."""
    seed: Annotated[int, Field(ge=0, le=2**31 - 1), WHOLE] = 0
    """Seed of every random number."""
    background: Literal["transparent", "environment", "white"] = "transparent"
    """Background behind the object."""
    exposure_ev: Annotated[float, Field(ge=-64.0, le=64.0)] = 0.0
    """Brighten the PNG by this many stops; the EXR stays as it is."""
    tone_mapping: ToneMapping = "linear"
    """Tone curve of the PNG."""


class RenderQuality(RenderSettings):
    """How pictures are made, under one name."""

    name: PictureName | None = None
    """Default: the quality itself."""

    @property
    def called(self) -> str:
        """Return the name."""
        return self.name or self.quality


_PLACE = r"\{(?:asset|environment|quality|camera)\}"
_PART = rf"(?:[A-Za-z0-9_]|{_PLACE})(?:[A-Za-z0-9._-]|{_PLACE})*"

_PATH = "a relative path of plain names that may name {asset}, {environment}, {quality} and {camera}"


class RenderOutput(Wanted):
    """The files written for every picture."""

    files: Annotated[
        list[Literal["png", "exr"]],
        Field(min_length=1, max_length=2, default_factory=lambda: ["png", "exr"]),
    ]
    passes: Annotated[list[Pass], Field(max_length=12, default_factory=lambda: list(get_args(Pass)))]
    """Layers of the EXR besides the picture; "cryptomatte" is the object's mask."""
    half: bool = True
    """16-bit instead of 32-bit floats in EXR files; depth and the Cryptomatte always have 32."""
    path: Annotated[str, Field(max_length=300, pattern=rf"^{_PART}(?:/{_PART})*$", description=_PATH)] = (
        "{asset}/{environment}/{quality}/{camera}"
    )
    """Path of a picture without suffix."""


class RenderSpec(Wanted):
    """Assets x environments x cameras x qualities, one picture each."""

    name: Name = "batch"
    assets: Entries[RenderAsset]
    environments: Entries[RenderEnvironment]
    cameras: Entries[RenderCameras]
    qualities: Annotated[Entries[RenderQuality], Field(default_factory=lambda: [RenderQuality()])]
    output: Annotated[RenderOutput, Field(default_factory=RenderOutput)]


def clashes(spec: RenderSpec) -> Iterator[tuple[str, str]]:
    """Yield (JSON pointer, message) of what gives two pictures of an order one name."""
    needed = ["{camera}"]
    for kind, place in (("asset", "assets"), ("environment", "environments"), ("quality", "qualities")):
        names = [entry.called for entry in getattr(spec, place)]
        known = [name.casefold() for name in names]
        needed += [f"{{{kind}}}"] if len(names) > 1 else []
        for index, name in enumerate(names):
            if name.casefold() in known[:index]:
                yield f"/{place}/{index}/name", f'a second {kind} is called "{name}"; give it another name'
    lacking = ", ".join(place for place in sorted(needed) if place not in spec.output.path)
    if lacking:
        yield "/output/path", f"path: {spec.output.path!r} gives pictures the same name; add {lacking}"
