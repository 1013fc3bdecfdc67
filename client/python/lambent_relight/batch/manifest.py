"""The manifest of a batch: an order of pictures whose bundles, maps and cameras may be files here.

Source: docs/howto/batch.md.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from lambent_core.pictures import (
    UNCLEAR,
    Entries,
    EnvironmentInput,
    RenderAsset,
    RenderCameras,
    RenderEnvironment,
    RenderOutput,
    RenderQuality,
    RenderSettings,
    RenderSpec,
    safe_name,
)
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from lambent_relight.edits import MaterialEdit

SCHEMA = "lambent-batch/1"
"""The only value of `schema` that a reader accepts."""
MAX_PICTURES = 100_000
SUFFIXES = ("png", "exr")
LINEAR = "npz"
"""Suffix of a picture's linear radiance, which exposure, tone mapping and background are applied to."""


def place(path: str, suffix: str) -> str:
    """Return where a file of the picture `path` lies in the output folder."""
    return f".linear/{path}.{suffix}" if suffix == LINEAR else f"{path}.{suffix}"


def _as_path(value: Any, info: ValidationInfo) -> Any:
    """Return text as a path from the folder `base` of the context on."""
    is_text = isinstance(value, str) and bool(value) and value.isprintable()
    return (info.context or {}).get("base", Path()) / Path(value).expanduser() if is_text else value


File = Annotated[Path | None, BeforeValidator(_as_path)]
Identifier = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f]+$")]


class Asset(RenderAsset):
    """A bundle in one material and pose: a folder or zip, or the id of a bundle on a server."""

    bundle: File = None
    bundle_id: Identifier = ""

    @model_validator(mode="after")
    def _check_source(self) -> "Asset":
        if (self.bundle is None) == (not self.bundle_id):
            raise ValueError("one of bundle and bundle_id is needed")
        return self

    @property
    def called(self) -> str:
        """Return the name, by default that of the file."""
        return self.name or safe_name(self.bundle.stem if self.bundle is not None else self.bundle_id)

    @property
    def edit(self) -> MaterialEdit:
        """Return the changes of the material as the renderer applies them."""
        return MaterialEdit(**self.material.model_dump())


class Light(RenderEnvironment):
    """An environment map as it is to be used: a file, or the id of an environment on a server."""

    map: File = None
    environment_id: Identifier = ""

    @model_validator(mode="after")
    def _check_source(self) -> "Light":
        if (self.map is None) == (not self.environment_id):
            raise ValueError("one of map and environment_id is needed")
        return self

    @property
    def called(self) -> str:
        """Return the name, by default that of the file."""
        return self.name or safe_name(self.map.stem if self.map is not None else self.environment_id)

    @property
    def given(self) -> dict[str, Any]:
        """Return how the map's file is read."""
        return self.model_dump(include=set(EnvironmentInput.model_fields))


class Cameras(RenderCameras):
    """Some cameras; exactly one of turntable, file, views, all_views and poses selects them."""

    file: File = None
    """A cameras.json; with `views` only those."""

    @model_validator(mode="after")
    def _check_source(self) -> "Cameras":
        kinds = [name for name in ("turntable", "file", "all_views", "poses") if getattr(self, name)]
        if len(kinds) + bool(self.views) != 1 and not (kinds == ["file"] and self.views):
            raise PydanticCustomError(
                UNCLEAR, "exactly one of turntable, file, views, all_views and poses is needed"
            )
        return self


class Files(RenderOutput):
    """The files written for every picture, and what is kept or drawn besides."""

    linear: bool = False
    """Whether the linear picture is kept: another exposure, tone curve or background renders nothing."""
    probes: bool = False
    """Whether a chrome and a grey ball are drawn into the PNG's corner."""


class Manifest(RenderSpec):
    """A whole batch."""

    schema_: Annotated[Literal["lambent-batch/1"], Field(alias="schema")]
    assets: Entries[Asset]
    environments: Annotated[Sequence[Light], Field(min_length=1, max_length=10_000)]
    cameras: Entries[Cameras]
    settings: Annotated[RenderSettings, Field(default_factory=RenderSettings)]
    """Settings that the qualities share, where they do not state their own."""
    _origins: list[int] = PrivateAttr(default_factory=list)

    def model_post_init(self, context: Any) -> None:
        """Keep the places of the environments in the document, where each may stand for several."""
        self._origins = (context or {}).get("origins", [])

    def light_pointer(self, index: int) -> str:
        """Return the place of an environment in the document."""
        return f"/environments/{self._origins[index] if self._origins else index}"

    @model_validator(mode="after")
    def _share_settings(self) -> "Manifest":
        shared = {name: getattr(self.settings, name) for name in self.settings.model_fields_set}
        self.qualities = [
            RenderQuality.model_construct(
                **shared | {name: getattr(each, name) for name in each.model_fields_set}
            )
            for each in self.qualities
        ]
        return self

    @property
    def files(self) -> Files:
        """Return the files written for every picture."""
        return Files(**dict(self.output))
