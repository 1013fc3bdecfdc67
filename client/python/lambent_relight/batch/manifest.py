"""What a batch consists of. Source: docs/howto/batch.md (the manifest)."""

from dataclasses import dataclass, field
from pathlib import Path

from lambent_proto.pictures import RenderSettings

from lambent_relight.aovs import PASSES
from lambent_relight.cameras import Camera
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.input import EnvironmentInput

SCHEMA = "lambent-batch/1"
"""What `schema` must say; a reader refuses another number."""
MAX_PICTURES = 100_000
SUFFIXES = ("png", "exr")
PLACES = ("asset", "environment", "quality", "camera")
DEFAULT_PATH = "{asset}/{environment}/{quality}/{camera}"
LINEAR = "npz"
"""Suffix of a picture's linear radiance, which exposure, tone mapping and background are applied to."""


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


@dataclass(frozen=True, kw_only=True)
class Cameras:
    """Some cameras; exactly one of `turntable`, `file`, `views`, `all_views` and `given` says which."""

    turntable: int = 0
    """Cameras evenly around the object."""
    elevation_deg: float | None = None
    radius: float | None = None
    """Distance from the middle of the object, scene units."""
    field_of_view_deg: float | None = None
    start_deg: float = 0.0
    file: Path | None = None
    """A cameras.json; with `views` only those."""
    views: tuple[str, ...] = ()
    """Names of the bundle's own cameras."""
    all_views: bool = False
    given: tuple[Camera, ...] = ()
    name: str = ""
    """Stands before the names of the cameras, so that two entries can be told apart."""
    size: int = 0
    """Longer side of the pictures in pixels; 0 leaves them as they are."""
    pointer: str = field(default="", compare=False)


class Quality(RenderSettings):
    """The settings of pictures under one name."""

    name: str = "refined"


@dataclass(frozen=True, kw_only=True, slots=True)
class Files:
    """What is written of every picture, and where."""

    suffixes: tuple[str, ...] = SUFFIXES
    passes: tuple[str, ...] = PASSES
    half: bool = True
    """16-bit instead of 32-bit floats in EXR files."""
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
