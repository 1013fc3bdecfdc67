"""A manifest from plain values, as YAML, JSON or a message give them."""

import re
import string
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from lambent_proto.pictures import (
    WHOLE,
    Angle,
    AssetUse,
    LightUse,
    Name,
    Passes,
    PictureName,
    Positive,
    RenderOutput,
    RenderQuality,
    RenderSettings,
    Side,
    Wanted,
    safe_name,
)
from pydantic import BeforeValidator, Field, ValidationError, ValidationInfo, field_validator, model_validator

from lambent_relight.aovs import PASSES
from lambent_relight.batch.manifest import (
    DEFAULT_PATH,
    PLACES,
    Asset,
    Cameras,
    Files,
    Light,
    Manifest,
    Quality,
)
from lambent_relight.cameras import parse_camera_list
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.input import EnvironmentInput
from lambent_relight.errors import CameraError, RelightError
from lambent_relight.validation import Problem, problems_of, shown

Kind = TypeVar("Kind", bound=Wanted)
_WORDS = {"all": list(PASSES), "none": []}
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
Text = Annotated[str, Field(min_length=1, max_length=4096, pattern=r"^[^\x00-\x1f]+$")]
Identifier = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f]+$")]
Entries = Annotated[list[Any], Field(min_length=1, max_length=1000)]


class ManifestError(RelightError):
    """A manifest cannot be used; `problems` holds every one that was found. Code `batch.manifest`."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        shown_problems = "; ".join(f"{each.pointer or '/'}: {each.message}" for each in problems[:20])
        super().__init__("batch.manifest", shown_problems, "see docs/howto/batch.md for every field")
        self.problems = tuple(problems)


class _Document(Wanted):
    schema_: Annotated[Literal["lambent-batch/1"], Field(alias="schema")]
    name: Name = "batch"
    assets: Entries
    environments: Entries
    cameras: Entries
    settings: Any = None
    qualities: Entries | None = None
    output: Any = None


class _Asset(AssetUse):
    bundle: Text | None = None
    bundle_id: Identifier | None = None

    @model_validator(mode="after")
    def _check(self) -> "_Asset":
        return _one_of(self, "bundle", "bundle_id")


class _Light(LightUse):
    map: Text | None = None
    environment_id: Identifier | None = None
    rotate_deg: Annotated[
        list[Angle],
        Field(min_length=1, max_length=10_000, default_factory=lambda: [0.0]),
        BeforeValidator(lambda value: value if isinstance(value, list) else [value]),
    ]
    _is_turned_list: bool = False

    @model_validator(mode="wrap")
    @classmethod
    def _check(cls, value: Any, handler: Callable[[Any], "_Light"]) -> "_Light":
        entry = _one_of(handler(value), "map", "environment_id")
        entry._is_turned_list = isinstance(value.get("rotate_deg"), list)
        return entry


class _Cameras(Wanted):
    turntable: Annotated[int, Field(ge=1, le=10_000), WHOLE] | None = None
    file: Text | None = None
    views: (
        Annotated[list[Annotated[str, Field(min_length=1, max_length=200)]], Field(min_length=1)] | None
    ) = None
    all_views: bool = False
    poses: Annotated[list[Any], Field(min_length=1, max_length=10_000)] | None = None
    elevation_deg: Annotated[float, Field(ge=-90.0, le=90.0)] | None = None
    radius: Positive | None = None
    field_of_view_deg: Annotated[float, Field(ge=0.1, le=179.0)] | None = None
    start_deg: Angle = 0.0
    name: PictureName | None = None
    size: Side = 0

    @field_validator("elevation_deg", "radius", "field_of_view_deg", "start_deg")
    @classmethod
    def _check_place(cls, value: float, info: ValidationInfo) -> float:
        if info.data.get("turntable", 1) is None:
            raise ValueError("this places a turntable and has no meaning here")
        return value

    @field_validator("poses")
    @classmethod
    def _check_poses(cls, value: list[Any]) -> list[Any]:
        try:
            return parse_camera_list(value, source="poses")
        except CameraError as error:
            raise ValueError(error.message) from error

    @model_validator(mode="after")
    def _check(self) -> "_Cameras":
        kinds = [name for name in ("turntable", "file", "all_views", "poses") if getattr(self, name)]
        if len(kinds) + (self.views is not None) != 1 and not (kinds == ["file"] and self.views):
            raise ValueError("one of turntable, file, views, all_views and poses is needed")
        return self


class _Output(RenderOutput):
    passes: Annotated[
        Passes,
        Field(default_factory=lambda: list(PASSES)),
        BeforeValidator(lambda value: _WORDS.get(value, value) if isinstance(value, str) else value),
    ]
    path: Annotated[str, Field(min_length=1, max_length=500)] = DEFAULT_PATH

    @field_validator("path")
    @classmethod
    def _check_path(cls, path: str) -> str:
        """Refuse a pattern that leads out of the folder."""
        try:
            parts = path.format(**dict.fromkeys(PLACES, "x")).split("/")
            unknown = _places(path) - set(PLACES)
        except (ValueError, KeyError, IndexError, AttributeError):
            parts, unknown = [], {""}
        if unknown:
            known = ", ".join(f"{{{place}}}" for place in PLACES)
            raise ValueError(f"{shown(path)} may name {known} only")
        if not all(NAME.fullmatch(part) for part in parts):
            raise ValueError(f"{shown(path)} is no relative path of plain names")
        return path


def read_manifest(document: Any, base: Path) -> Manifest:
    """Return the manifest that `document` describes; relative paths start at `base`.

    Nothing is looked up on the disk. Raises ManifestError with every problem that was found.
    """
    reader = _Reader()
    top = document if isinstance(document, dict) else {}
    reader.read(_Document, document, "")
    settings = reader.read(RenderSettings, top.get("settings") or {}, "/settings") or RenderSettings()
    output = reader.read(_Output, top.get("output") or {}, "/output")
    assets = [_asset(each, at, base) for each, at in reader.entries(_Asset, top, "assets", "bundle")]
    found = reader.entries(_Light, top, "environments", "map")
    lights = [light for each, at in found for light in _lights(each, at, base)]
    cameras = [_cameras(each, at, base) for each, at in reader.entries(_Cameras, top, "cameras", "file")]
    found_qualities = list(reader.entries(RenderQuality, top, "qualities", "quality"))
    qualities = [_quality(each, settings) for each, _ in found_qualities]
    if top.get("qualities") is None:
        qualities = [_quality(RenderQuality(), settings)]
    for kind, names in (
        ("asset", [(each.name, each.pointer) for each in assets]),
        ("environment", [(each.name, each.pointer) for each in lights]),
        ("quality", [(each.name, "/qualities") for each in qualities]),
    ):
        reader.check_names(kind, names)
    if output is not None:
        reader.check_path(output.path, {"asset": assets, "environment": lights, "quality": qualities})
    if reader.problems:
        raise ManifestError(reader.problems)
    assert output is not None
    return Manifest(
        name=top.get("name") or "batch",
        assets=tuple(assets),
        environments=tuple(lights),
        cameras=tuple(cameras),
        qualities=tuple(qualities),
        files=Files(
            suffixes=tuple(output.files), passes=tuple(output.passes), half=output.half, path=output.path
        ),
    )


class _Reader:
    """Reads parts of one document and collects what is wrong with them."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def read(self, model: type[Kind], value: Any, pointer: str) -> Kind | None:
        """Return a part; None where it cannot be used. What is empty counts as left out."""
        if isinstance(value, dict):
            value = {name: each for name, each in value.items() if each is not None}
        try:
            return model.model_validate(value)
        except ValidationError as error:
            self.problems += problems_of(error, model, pointer)
            return None

    def entries(
        self, model: type[Kind], top: dict[str, Any], name: str, short: str
    ) -> Iterator[tuple[Kind, str]]:
        """Yield the entries of a list and their places; a word alone is the member `short`."""
        listed = top.get(name)
        for index, value in enumerate(listed if isinstance(listed, list) else ()):
            pointer = f"/{name}/{index}"
            if isinstance(value, str):
                value = {"all_views": True} if (short, value) == ("file", "all") else {short: value}
            entry = self.read(model, value, pointer)
            if entry is not None:
                yield entry, pointer

    def check_names(self, kind: str, names: Sequence[tuple[str, str]]) -> None:
        """Report a second entry of the same name."""
        seen: set[str] = set()
        for name, pointer in names:
            if name.casefold() in seen:
                message = f'a second {kind} is called "{name}"; give it another name'
                self.problems.append(Problem(pointer, message))
            seen.add(name.casefold())

    def check_path(self, path: str, entries: dict[str, Sequence[Any]]) -> None:
        """Report a pattern that gives two pictures the same name."""
        needed = {"camera"} | {place for place, each in entries.items() if len(each) > 1}
        lacking = ", ".join(f"{{{place}}}" for place in sorted(needed - _places(path)))
        if lacking:
            message = f"path: {shown(path)} gives pictures the same name; add {lacking}"
            self.problems.append(Problem("/output/path", message))


def _places(path: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(path) if name is not None}


def _one_of(entry: Kind, file: str, identifier: str) -> Kind:
    if (getattr(entry, file) is None) == (getattr(entry, identifier) is None):
        raise ValueError(f"one of {file} and {identifier} is needed")
    return entry


def _path(base: Path, given: str | None) -> Path | None:
    return None if given is None else base / Path(given).expanduser()


def _asset(given: _Asset, pointer: str, base: Path) -> Asset:
    path, material = _path(base, given.bundle), given.material.model_dump()
    colours = {name: tuple(value) for name, value in material.items() if isinstance(value, list)}
    return Asset(
        name=given.name or safe_name(path.stem if path is not None else given.bundle_id or ""),
        path=path,
        bundle_id=given.bundle_id or "",
        edit=MaterialEdit(**{**material, **colours}),
        object_rotate_deg=given.object_rotate_deg,
        pointer=pointer,
    )


def _lights(given: _Light, pointer: str, base: Path) -> Iterator[Light]:
    """Yield the entry, once for every angle it is to be turned by."""
    path = _path(base, given.map)
    name = given.name or safe_name(path.stem if path is not None else given.environment_id or "")
    for angle in given.rotate_deg:
        yield Light(
            name=f"{name}_{angle:g}" if given._is_turned_list else name,
            path=path,
            environment_id=given.environment_id or "",
            given=EnvironmentInput(axes=given.axes, mend=given.mend, sun_clamp=given.sun_clamp),
            rotate_deg=angle,
            pointer=pointer,
        )


def _cameras(given: _Cameras, pointer: str, base: Path) -> Cameras:
    return Cameras(
        turntable=given.turntable or 0,
        start_deg=given.start_deg,
        elevation_deg=given.elevation_deg,
        radius=given.radius,
        field_of_view_deg=given.field_of_view_deg,
        file=_path(base, given.file),
        views=tuple(given.views or ()),
        all_views=given.all_views,
        given=tuple(given.poses or ()),
        name=given.name or "",
        size=given.size,
        pointer=pointer,
    )


def _quality(given: RenderQuality, settings: RenderSettings) -> Quality:
    values = {**settings.model_dump(), **given.model_dump(exclude_unset=True)}
    return Quality(**{**values, "name": given.name or values["quality"]})
