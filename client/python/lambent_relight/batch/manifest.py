"""The parts of a batch. Source: docs/howto/batch.md (the manifest)."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from lambent_core.errors import CameraError
from lambent_core.pictures import WHOLE, RenderCameras, RenderSettings
from pydantic import BeforeValidator, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from lambent_relight.aovs import PASSES
from lambent_relight.cameras import parse_camera_list
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.input import EnvironmentInput

SCHEMA = "lambent-batch/1"
"""The only value of `schema` that a reader accepts."""
MAX_PICTURES = 100_000
SUFFIXES = ("png", "exr")
DEFAULT_PATH = "{asset}/{environment}/{quality}/{camera}"
LINEAR = "npz"
"""Suffix of a picture's linear radiance, which exposure, tone mapping and background are applied to."""
Text = Annotated[str, Field(min_length=1, max_length=200)]


def place(path: str, suffix: str) -> str:
    """Return where a file of the picture `path` lies in the output folder."""
    return f".linear/{path}.{suffix}" if suffix == LINEAR else f"{path}.{suffix}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Asset:
    """A bundle in one material and pose: a folder or zip, or the id of a bundle on a server."""

    name: str
    path: Path | None = None
    bundle_id: str = ""
    edit: MaterialEdit = field(default_factory=MaterialEdit)
    object_rotate_deg: float = 0.0
    pointer: str = field(default="", compare=False)


@dataclass(frozen=True, kw_only=True, slots=True)
class Light:
    """An environment map as it is to be used: a file, or the id of an environment on a server."""

    name: str
    path: Path | None = None
    environment_id: str = ""
    given: EnvironmentInput = field(default_factory=EnvironmentInput)
    rotate_deg: float = 0.0
    pointer: str = field(default="", compare=False)


def _as_path(value: Any, info: ValidationInfo) -> Any:
    """Return text as a path from the folder `base` of the context on."""
    return (info.context or {}).get("base", Path()) / Path(value).expanduser() if _is_text(value) else value


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and bool(value) and value.isprintable()


def _as_cameras(value: Any) -> Any:
    """Return the cameras that a document describes."""
    if not isinstance(value, list) or not 1 <= len(value) <= 10_000:
        raise ValueError("a list of 1 to 10000 cameras is expected")
    try:
        return tuple(parse_camera_list(value, source="poses"))
    except CameraError as error:
        raise ValueError(error.message) from error


File = Annotated[Path | None, BeforeValidator(_as_path)]


class Cameras(RenderCameras):
    """Some cameras; exactly one of `turntable`, `file`, `views`, `all_views` and `poses` says which."""

    model_config = ConfigDict(frozen=True)

    turntable: Annotated[int, Field(ge=1, le=10_000), WHOLE] = 0
    file: File = None
    """A cameras.json; with `views` only those."""
    views: Annotated[tuple[Text, ...], Field(strict=False, min_length=1, max_length=10_000)] = ()  # type: ignore[assignment]
    poses: Annotated[tuple[Any, ...], BeforeValidator(_as_cameras)] = ()  # type: ignore[assignment]

    @field_validator("elevation_deg", "radius", "field_of_view_deg", "start_deg")
    @classmethod
    def _check_place(cls, value: float, info: ValidationInfo) -> float:
        if info.data.get("turntable", 1) == 0:
            raise ValueError("this places a turntable and has no meaning here")
        return value

    @model_validator(mode="after")
    def _check(self) -> "Cameras":
        kinds = [name for name in ("turntable", "file", "all_views", "poses") if getattr(self, name)]
        if len(kinds) + bool(self.views) != 1 and not (kinds == ["file"] and self.views):
            raise ValueError("one of turntable, file, views, all_views and poses is needed")
        return self


class Quality(RenderSettings):
    """The settings of pictures under one name."""

    name: str = "refined"


@dataclass(frozen=True, kw_only=True, slots=True)
class Files:
    """The files written for every picture, and where."""

    suffixes: tuple[str, ...] = SUFFIXES
    passes: tuple[str, ...] = PASSES
    half: bool = True
    """16-bit instead of 32-bit floats in EXR files; depth and the Cryptomatte always have 32."""
    path: str = DEFAULT_PATH
    """Path in the output folder without suffix."""
    linear: bool = False
    """Whether the linear picture is kept: another exposure, tone curve or background renders nothing."""
    probes: bool = False
    """Whether a chrome and a grey ball stand in the PNG's corner."""


@dataclass(frozen=True, kw_only=True)
class Manifest:
    """A whole batch."""

    name: str
    assets: tuple[Asset, ...]
    environments: tuple[Light, ...]
    cameras: tuple[Cameras, ...]
    qualities: tuple[Quality, ...]
    files: Files
