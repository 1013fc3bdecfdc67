"""A manifest from plain values, as YAML, JSON or a message give them."""

import re
import string
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from lambent_relight.aovs import PASSES
from lambent_relight.batch import members as checks
from lambent_relight.batch.manifest import (
    BACKGROUNDS,
    DEFAULT_PATH,
    PLACES,
    SCHEMA,
    SUFFIXES,
    Asset,
    Cameras,
    Files,
    Light,
    Manifest,
    Quality,
)
from lambent_relight.batch.members import Members, Problem, Problems, shown
from lambent_relight.cameras import parse_camera_list
from lambent_relight.edits import MaterialEdit
from lambent_relight.environment.axes import OURS, QUARTER_TURNS
from lambent_relight.environment.input import EnvironmentInput
from lambent_relight.errors import CameraError, RelightError
from lambent_relight.refined.sampling_plan import BOUNCES
from lambent_relight.renderer import QUALITIES
from lambent_relight.tone_mapping import NAMES as TONE_MAPPINGS

T = TypeVar("T", Asset, Light, Quality)
NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,63}")
_MAX_ENTRIES = 1000
_MAX_SIDE = 16384
_ANGLE = checks.number(-36000.0, 36000.0)


class ManifestError(RelightError):
    """A manifest cannot be used; `problems` holds every one that was found. Code `batch.manifest`."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        shown_problems = "; ".join(f"{each.pointer or '/'}: {each.message}" for each in problems[:20])
        super().__init__("batch.manifest", shown_problems, "see docs/howto/batch.md for every field")
        self.problems = tuple(problems)


def read_manifest(document: Any, base: Path) -> Manifest:
    """Return the manifest that `document` describes; relative paths start at `base`.

    Nothing is looked up on the disk. Raises ManifestError with every problem that was found.
    """
    problems = Problems()
    top = Members(document, "", problems)
    schema = top.require("schema", checks.text(100), SCHEMA)
    if schema != SCHEMA:
        problems.report("/schema", f"schema: this program reads {SCHEMA}, not {shown(schema)}")
    settings = _quality(Members(top.raw("settings") or {}, "/settings", problems), Quality(), common=True)
    manifest = Manifest(
        name=top.take("name", checks.text(100), "batch"),
        assets=tuple(_entries(top, "assets", lambda value, at: [_asset(value, at, problems, base)])),
        environments=tuple(_entries(top, "environments", lambda v, at: _lights(v, at, problems, base))),
        cameras=tuple(_entries(top, "cameras", lambda value, at: [_cameras(value, at, problems, base)])),
        qualities=tuple(
            _entries(top, "qualities", lambda value, at: [_named_quality(value, at, problems, settings)])
        )
        if top.has("qualities")
        else (settings,),
        files=_files(Members(top.raw("output") or {}, "/output", problems)),
    )
    top.close()
    for kind, entries in (
        ("asset", manifest.assets),
        ("environment", manifest.environments),
        ("quality", manifest.qualities),
    ):
        _check_names(kind, entries, problems)
    _check_path(manifest, problems)
    if problems.found:
        raise ManifestError(problems.found)
    return manifest


def safe_name(name: str) -> str:
    """Return a name that is one part of a path everywhere."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", name).lstrip(".-")[:64] or "_"


def _entries(top: Members, name: str, read: Callable[[Any, str], list[Any]]) -> list[Any]:
    value = top.raw(name)
    if not isinstance(value, list) or not 1 <= len(value) <= _MAX_ENTRIES:
        where = top.at(name) if top.has(name) else ""
        found = shown(value) if top.has(name) else "none"
        top.problems.report(where, f"{name}: a list of 1 to {_MAX_ENTRIES} is expected, not {found}")
        return []
    return [item for index, entry in enumerate(value) for item in read(entry, f"{top.at(name)}/{index}")]


def _name(value: Any) -> str:
    found = checks.text(64)(value)
    if not NAME.fullmatch(found):
        raise ValueError(f"letters, digits, '.', '_' and '-' are expected, not {shown(found)}")
    return found


def _path(base: Path) -> checks.Check[Path]:
    return lambda value: base / Path(checks.text()(value)).expanduser()


def _source(fields: Members, file: str, identifier: str, base: Path) -> tuple[Path | None, str]:
    """Return the path or the id of an entry; one of the two must be there."""
    if fields.is_mapping and fields.has(file) == fields.has(identifier):
        fields.problems.report(fields.pointer, f"one of {file} and {identifier} is needed")
    path = fields.take(file, _path(base), base) if fields.has(file) else None
    return path, fields.take(identifier, checks.text(64), "")


def _asset(value: Any, pointer: str, problems: Problems, base: Path) -> Asset:
    fields = Members({"bundle": value} if isinstance(value, str) else value, pointer, problems)
    path, bundle_id = _source(fields, "bundle", "bundle_id", base)
    default = safe_name(path.stem if path is not None else bundle_id)
    asset = Asset(
        name=fields.take("name", _name, default),
        path=path,
        bundle_id=bundle_id,
        edit=_edit(Members(fields.raw("material") or {}, fields.at("material"), problems)),
        object_rotate_deg=fields.take("object_rotate_deg", _ANGLE, 0.0),
        pointer=pointer,
    )
    fields.close()
    return asset


def _edit(fields: Members) -> MaterialEdit:
    gain = fields.take("albedo_gain", checks.colour(1e-6, 1e6), (1.0, 1.0, 1.0))
    albedo = fields.take("albedo", checks.colour(0.0, 1.0), (0.0, 0.0, 0.0)) if fields.has("albedo") else None
    edit = MaterialEdit(
        albedo_gain=gain,
        albedo=albedo,
        roughness_scale=fields.take("roughness_scale", checks.number(0.0, 1e6), 1.0),
    )
    fields.close()
    return edit


def _lights(value: Any, pointer: str, problems: Problems, base: Path) -> list[Light]:
    """Return the entry, once for every angle it is to be turned by."""
    fields = Members({"map": value} if isinstance(value, str) else value, pointer, problems)
    path, environment_id = _source(fields, "map", "environment_id", base)
    default = safe_name(path.stem if path is not None else environment_id)
    name = fields.take("name", _name, default)
    given = EnvironmentInput(
        axes=fields.take("axes", checks.choice(QUARTER_TURNS), OURS),
        mend=fields.take("mend", checks.flag, False),
        sun_clamp=fields.take("sun_clamp", checks.number(0.0, 1e30), 0.0),
    )
    many = isinstance(fields.raw("rotate_deg"), list)
    angles = (
        fields.take("rotate_deg", checks.list_of(_ANGLE), (0.0,))
        if many
        else (fields.take("rotate_deg", _ANGLE, 0.0),)
    )
    fields.close()
    return [
        Light(
            name=f"{name}_{angle:g}" if many else name,
            path=path,
            environment_id=environment_id,
            given=given,
            rotate_deg=angle,
            pointer=pointer,
        )
        for angle in angles
    ]


def _cameras(value: Any, pointer: str, problems: Problems, base: Path) -> Cameras:
    if value == "all":
        value = {"all_views": True}
    fields = Members({"file": value} if isinstance(value, str) else value, pointer, problems)
    kinds = [
        name
        for name in ("turntable", "file", "all_views", "poses")
        if fields.has(name) and fields.raw(name) is not False
    ]
    named = fields.has("views")
    if fields.is_mapping and len(kinds) + named != 1 and not (kinds == ["file"] and named):
        problems.report(pointer, "one of turntable, file, views, all_views and poses is needed")
    optional = {
        name: fields.take(name, check, 0.0) if fields.has(name) else None
        for name, check in (
            ("elevation_deg", checks.number(-90.0, 90.0)),
            ("radius", checks.number(1e-6, 1e6)),
            ("field_of_view_deg", checks.number(0.1, 179.0)),
        )
    }
    cameras = Cameras(
        turntable=fields.take("turntable", checks.whole(1, 10_000), 1) if "turntable" in kinds else 0,
        start_deg=fields.take("start_deg", _ANGLE, 0.0),
        file=fields.take("file", _path(base), base) if "file" in kinds else None,
        views=fields.take("views", checks.list_of(checks.text(200)), ()),
        all_views=fields.take("all_views", checks.flag, False),
        given=_camera_list(fields) if "poses" in kinds else (),
        name=fields.take("name", _name, ""),
        size=fields.take("size", checks.whole(0, _MAX_SIDE), 0),
        pointer=pointer,
        **optional,
    )
    if kinds != ["turntable"]:
        for name in ("elevation_deg", "radius", "field_of_view_deg", "start_deg"):
            if fields.has(name):
                problems.report(fields.at(name), f"{name} places a turntable and has no meaning here")
    fields.close()
    return cameras


def _camera_list(fields: Members) -> tuple[Any, ...]:
    entries = fields.raw("poses")
    if not isinstance(entries, list) or not 1 <= len(entries) <= 10_000:
        fields.problems.report(fields.at("poses"), "poses: 1 to 10000 cameras are expected")
        return ()
    try:
        return tuple(parse_camera_list(entries, source="poses"))
    except CameraError as error:
        fields.problems.report(fields.at("poses"), f"poses: {error.message}")
        return ()


def _quality(fields: Members, default: Quality, *, common: bool = False) -> Quality:
    quality = fields.take("quality", checks.choice(QUALITIES), default.quality)
    found = Quality(
        name=quality if common else fields.take("name", _name, quality),
        quality=quality,
        spp=fields.take("spp", checks.whole(2, 65536), default.spp),
        until_stderr=fields.take("until_stderr", checks.number(0.0, 0.999), default.until_stderr),
        antialias=fields.take("antialias", checks.whole(1, 8), default.antialias),
        indirect=fields.take("indirect", checks.flag, default.indirect),
        bounces=fields.take("bounces", checks.choice(BOUNCES), default.bounces),
        seed=fields.take("seed", checks.whole(0, 2**31 - 1), default.seed),
        background=fields.take("background", checks.choice(BACKGROUNDS), default.background),
        exposure_ev=fields.take("exposure_ev", checks.number(-64.0, 64.0), default.exposure_ev),
        tone_mapping=fields.take("tone_mapping", checks.choice(TONE_MAPPINGS), default.tone_mapping),
    )
    fields.close()
    return found


def _named_quality(value: Any, pointer: str, problems: Problems, settings: Quality) -> Quality:
    return _quality(
        Members({"quality": value} if isinstance(value, str) else value, pointer, problems), settings
    )


def _files(fields: Members) -> Files:
    passes = fields.raw("passes")
    words = {"all": PASSES, "none": ()}
    files = Files(
        suffixes=fields.take("files", checks.list_of(checks.choice(SUFFIXES), 1, 2), SUFFIXES),
        passes=words[passes]
        if isinstance(passes, str) and passes in words
        else fields.take("passes", checks.list_of(checks.choice(PASSES), 0), PASSES),
        half=fields.take("half", checks.flag, True),
        path=fields.take("path", checks.text(500), DEFAULT_PATH),
    )
    fields.close()
    return files


def _check_names(kind: str, entries: Sequence[T], problems: Problems) -> None:
    seen: set[str] = set()
    for entry in entries:
        if entry.name.casefold() in seen:
            where = getattr(entry, "pointer", "") or "/qualities"
            problems.report(where, f'a second {kind} is called "{entry.name}"; give it another name')
        seen.add(entry.name.casefold())


def _check_path(manifest: Manifest, problems: Problems) -> None:
    """Report a pattern that leads out of the folder or gives two pictures the same name."""
    path = manifest.files.path
    try:
        used = {name for _, name, _, _ in string.Formatter().parse(path) if name is not None}
        parts = path.format(**dict.fromkeys(PLACES, "x")).split("/")
    except (ValueError, KeyError, IndexError, AttributeError):
        used, parts = {""}, []
    known = ", ".join(f"{{{place}}}" for place in PLACES)
    if used - set(PLACES):
        problems.report("/output/path", f"path: {shown(path)} may name {known} only")
    elif not all(NAME.fullmatch(part) for part in parts):
        problems.report("/output/path", f"path: {shown(path)} is no relative path of plain names")
    counts = {"asset": manifest.assets, "environment": manifest.environments, "quality": manifest.qualities}
    needed = {"camera"} | {place for place, entries in counts.items() if len(entries) > 1}
    if not used - set(PLACES) and needed - used:
        lacking = ", ".join(f"{{{place}}}" for place in sorted(needed - used))
        problems.report("/output/path", f"path: {shown(path)} gives pictures the same name; add {lacking}")
