"""A manifest from plain values, as YAML, JSON or a message give them."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from lambent_core.errors import RelightError
from lambent_core.pictures import (
    Angle,
    Name,
    RenderAsset,
    RenderEnvironment,
    RenderOutput,
    RenderQuality,
    RenderSettings,
    Wanted,
    safe_name,
)
from pydantic import BeforeValidator, Field, ValidationError, model_validator

from lambent_relight.aovs import PASSES
from lambent_relight.batch.manifest import Asset, Cameras, File, Files, Light, Manifest, Quality
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.input import EnvironmentInput
from lambent_relight.validation import Problem, problems_of, shown

Kind = TypeVar("Kind", bound=Wanted)
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


class _Asset(RenderAsset):
    bundle: File = None
    bundle_id: Identifier | None = None  # type: ignore[assignment]

    @model_validator(mode="after")
    def _check(self) -> "_Asset":
        return _one_of(self, "bundle", "bundle_id")


class _Light(RenderEnvironment):
    map: File = None
    environment_id: Identifier | None = None  # type: ignore[assignment]
    rotate_deg: Annotated[  # type: ignore[assignment]
        list[Angle],
        Field(min_length=1, max_length=10_000, default_factory=lambda: [0.0]),
        BeforeValidator(lambda value: value if isinstance(value, list) else [value]),
    ]
    _is_list: bool = False

    @model_validator(mode="wrap")
    @classmethod
    def _check(cls, value: Any, handler: Callable[[Any], "_Light"]) -> "_Light":
        entry = _one_of(handler(value), "map", "environment_id")
        entry._is_list = isinstance(value.get("rotate_deg"), list)
        return entry


def read_manifest(document: Any, base: Path) -> Manifest:
    """Return the manifest that `document` describes; relative paths start at `base`.

    Nothing is looked up on the disk. Raises ManifestError with every problem that was found.
    """
    reader = _Reader(base)
    top = document if isinstance(document, dict) else {}
    reader.read(_Document, document, "")
    settings = reader.read(RenderSettings, top.get("settings") or {}, "/settings") or RenderSettings()
    written = top.get("output") or {}
    if isinstance(written, dict) and written.get("passes") in ("all", "none"):
        written = {**written, "passes": list(PASSES) if written["passes"] == "all" else []}
    output = reader.read(RenderOutput, written, "/output")
    assets = [_asset(each, at) for each, at in reader.entries(_Asset, top, "assets", "bundle")]
    found = reader.entries(_Light, top, "environments", "map")
    lights = [light for each, at in found for light in _lights(each, at)]
    cameras = [each for each, _ in reader.entries(Cameras, top, "cameras", "file")]
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

    def __init__(self, base: Path) -> None:
        self._base = base
        self.problems: list[Problem] = []

    def read(self, model: type[Kind], value: Any, pointer: str) -> Kind | None:
        """Return a part; None where it cannot be used. What is empty counts as left out."""
        if isinstance(value, dict):
            value = {name: each for name, each in value.items() if each is not None}
        try:
            return model.model_validate(value, context={"base": self._base})
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
        lacking = ", ".join(f"{{{each}}}" for each in sorted(needed) if f"{{{each}}}" not in path)
        if lacking:
            message = f"path: {shown(path)} gives pictures the same name; add {lacking}"
            self.problems.append(Problem("/output/path", message))


def _one_of(entry: Kind, file: str, identifier: str) -> Kind:
    if (getattr(entry, file) is None) == (getattr(entry, identifier) is None):
        raise ValueError(f"one of {file} and {identifier} is needed")
    return entry


def _asset(given: _Asset, pointer: str) -> Asset:
    path, material = given.bundle, given.material.model_dump()
    colours = {name: tuple(value) for name, value in material.items() if isinstance(value, list)}
    return Asset(
        name=given.name or safe_name(path.stem if path is not None else given.bundle_id or ""),
        path=path,
        bundle_id=given.bundle_id or "",
        edit=MaterialEdit(**{**material, **colours}),
        object_rotate_deg=given.object_rotate_deg,
        pointer=pointer,
    )


def _lights(given: _Light, pointer: str) -> Iterator[Light]:
    """Yield the entry, once for every angle it is to be turned by."""
    path = given.map
    name = given.name or safe_name(path.stem if path is not None else given.environment_id or "")
    for angle in given.rotate_deg:
        yield Light(
            name=f"{name}_{angle:g}" if given._is_list else name,
            path=path,
            environment_id=given.environment_id or "",
            given=EnvironmentInput(
                axes=given.axes, layout=given.layout, mend=given.mend, sun_clamp=given.sun_clamp
            ),
            rotate_deg=angle,
            pointer=pointer,
        )


def _quality(given: RenderQuality, settings: RenderSettings) -> Quality:
    values = {**settings.model_dump(), **given.model_dump(exclude_unset=True)}
    return Quality(**{**values, "name": given.name or values["quality"]})
