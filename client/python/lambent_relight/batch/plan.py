"""The pictures of a batch, one by one, and the hash of everything each depends on."""

import hashlib
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lambent_core.errors import CameraError, RelightError, SettingError
from lambent_core.files import file_sha256
from lambent_core.pictures import RenderQuality, safe_name

from lambent_relight.batch.manifest import (
    LINEAR,
    MAX_PICTURES,
    Asset,
    Cameras,
    Files,
    Light,
    Manifest,
)
from lambent_relight.bundle.bundle import Bundle, load_bundle
from lambent_relight.cameras import Camera, load_cameras, parse_camera_list
from lambent_relight.object_cameras import around_object

_SHEETS = re.compile(r"contact_sheet(_\d+)?")


@dataclass(frozen=True, kw_only=True)
class Row:
    """One picture to make. `path` is its place in the output folder, without suffix."""

    path: str
    asset: Asset
    light: Light
    quality: RenderQuality
    camera: Camera
    bundle_digest: str
    light_digest: str
    pointer: str = ""
    """Place of the asset in the manifest."""

    def key(self, suffix: str, files: Files) -> str:
        """Return the SHA-256 of everything that the bytes of one file depend on."""
        quality = self.quality.model_dump(exclude={"name"})
        shown = {name: quality.pop(name) for name in ("exposure_ev", "tone_mapping")}
        background = quality.pop("background")
        parts: dict[str, Any] = {
            "renderer": renderer_digest(),
            "bundle": self.bundle_digest,
            "edit": self.asset.material.model_dump(),
            "object_rotate_deg": self.asset.object_rotate_deg,
            "environment": self.light_digest,
            "given": self.light.given,
            "rotate_deg": self.light.rotate_deg,
            "camera": self.camera.key().hex(),
            "quality": quality,
            "suffix": suffix,
        }
        if suffix != LINEAR:
            parts["background"] = background
        # Exposure and tone curve are for screens: the EXR stays as it is.
        if suffix == "png":
            parts |= {**shown, "probes": files.probes}
        elif suffix == "exr":
            parts |= {"passes": sorted(files.passes), "half": files.half}
            if "cryptomatte" in files.passes:
                parts["object"] = self.asset.called
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()

    def names(self) -> dict[str, Any]:
        """Return the fields of a record that say which picture it is."""
        return {
            "path": self.path,
            "asset": self.asset.called,
            "environment": self.light.called,
            "quality": self.quality.called,
            "camera": self.camera.name,
        }

    def before(self, background: str) -> "Row":
        """Return the same picture before another background."""
        return replace(self, quality=self.quality.model_copy(update={"background": background}))


@dataclass(frozen=True, kw_only=True, slots=True)
class Failure:
    """Something that was not made, and why: `path` is a picture's, or ends in `*` for all of an asset."""

    path: str
    code: str
    message: str
    pointer: str = ""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The pictures to make, in the order that keeps bundles and maps open longest, and the failures."""

    rows: tuple[Row, ...]
    failures: tuple[Failure, ...]


def make_plan(
    manifest: Manifest,
    *,
    opening: Callable[[Path | str], Bundle] = load_bundle,
    known_lights: Mapping[str, str] = MappingProxyType({}),
) -> Plan:
    """Return the pictures of a manifest: by asset, quality, environment and camera.

    Bundles are opened (and checked) one after the other for their cameras, by `opening`, each of them once.
    What belongs to a bundle, map or file of cameras that cannot be read becomes a failure. `known_lights` has
    the SHA-256 of maps that lie on a server, by their id. Raises SettingError (`batch.too_many`) above
    100 000 pictures, and (`batch.same_name`) where two pictures have one name.
    """
    rows: list[Row] = []
    failures: list[Failure] = []
    digests = light_digests(manifest.environments, known_lights)
    known: dict[Path | None, _Opened] = {}
    for number, asset in enumerate(manifest.assets):
        pointer = f"/assets/{number}"
        if asset.bundle is None or asset.bundle not in known:
            known[asset.bundle] = _open(asset, manifest.cameras, opening)
        opened = known[asset.bundle]
        failures += [_failure(f"{asset.called}/*", error, at or pointer) for error, at in opened.errors]
        for quality in manifest.qualities:
            for index, light in enumerate(manifest.environments):
                map_digest = digests[light.called]
                for camera in opened.cameras:
                    path = manifest.output.path.format(
                        asset=asset.called,
                        environment=light.called,
                        quality=quality.called,
                        camera=safe_name(camera.name),
                    )
                    if isinstance(map_digest, Exception):
                        failures.append(_failure(path, map_digest, manifest.light_pointer(index)))
                        continue
                    rows.append(
                        Row(
                            path=path,
                            asset=asset,
                            light=light,
                            quality=quality,
                            camera=camera,
                            bundle_digest=opened.digest,
                            light_digest=map_digest,
                            pointer=pointer,
                        )
                    )
                _check_count(len(rows) + len(failures))
    check_names(rows)
    return Plan(rows=tuple(rows), failures=tuple(failures))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Opened:
    """A bundle's digest and cameras, and the errors met on the way with their places in the manifest."""

    digest: str = ""
    cameras: tuple[Camera, ...] = ()
    errors: tuple[tuple[Exception, str], ...] = ()


def _open(asset: Asset, entries: Sequence[Cameras], opening: Callable[[Path | str], Bundle]) -> _Opened:
    """Open the bundle of an asset; several materials of one bundle share what is found."""
    try:
        bundle = opening(_require_path(asset.bundle, asset.bundle_id))
        digest = bundle_digest(bundle)
    except (RelightError, OSError) as error:
        return _Opened(errors=((error, ""),))
    cameras: list[Camera] = []
    errors: list[tuple[Exception, str]] = []
    for index, entry in enumerate(entries):
        try:
            cameras += cameras_of(entry, bundle)
        except (RelightError, OSError) as error:
            errors.append((error, f"/cameras/{index}"))
    return _Opened(digest=digest, cameras=tuple(cameras), errors=tuple(errors))


def bundle_digest(bundle: Bundle) -> str:
    """Return the hash of a bundle's manifest, which holds those of all its files."""
    with bundle.source.open("manifest.json") as file:
        return hashlib.sha256(file.read()).hexdigest()


def light_digests(
    lights: Sequence[Light], known: Mapping[str, str] = MappingProxyType({})
) -> dict[str, str | Exception]:
    """Return the hash of every environment's map by its name; a map is read once, however it is turned."""
    places = {(light.map, light.environment_id): light for light in lights}
    digests = {place: known.get(place[1]) or light_digest(light) for place, light in places.items()}
    return {light.called: digests[light.map, light.environment_id] for light in lights}


def cameras_of(entry: Cameras, bundle: Bundle) -> list[Camera]:
    """Return the cameras that an entry of a manifest stands for, with a bundle's own where it asks for them.

    Raises CameraError for a file that cannot be read and for a name that is not there.
    """
    stated = stated_cameras(entry)
    if stated is not None:
        return stated
    if not entry.turntable:
        return _picked(bundle.cameras(), entry, "the bundle")
    places = {"size", "start_deg", "elevation_deg", "radius", "field_of_view_deg"}
    around = around_object(bundle, entry.turntable, **entry.model_dump(include=places))
    return [_named(camera, entry) for camera in around]


def stated_cameras(entry: Cameras) -> list[Camera] | None:
    """Return the cameras that an entry holds or names a file of; None where it asks for those of a bundle."""
    if entry.poses:
        poses = parse_camera_list([each.model_dump() for each in entry.poses], source="poses")
        return _picked(poses, entry, "poses")
    if entry.file is not None:
        return _picked(load_cameras(entry.file), entry, entry.file.name)
    return None


def _picked(known: list[Camera], entry: Cameras, source: str) -> list[Camera]:
    """Return the cameras that are asked for, at the size and with the names that are asked for."""
    if entry.views:
        by_name = {camera.name: camera for camera in known}
        missing = [name for name in entry.views if name not in by_name]
        if missing:
            raise CameraError(
                "camera.unknown",
                f"there is no camera {missing[0]!r} in {source}",
                f"there are {', '.join(list(by_name)[:8])}{' ...' if len(by_name) > 8 else ''}",
            )
        known = [by_name[name] for name in entry.views]
    return [_named(_sized(camera, entry.size), entry) for camera in known]


def _named(camera: Camera, entry: Cameras) -> Camera:
    if not entry.name:
        return camera
    own = camera.name.removeprefix("turntable_") if entry.turntable else camera.name
    return replace(camera, name=f"{entry.name}_{own}")


def _sized(camera: Camera, size: int) -> Camera:
    longer = max(camera.width, camera.height)
    if size in (0, longer):
        return camera
    return camera.resized(
        max(1, round(camera.width * size / longer)), max(1, round(camera.height * size / longer))
    )


@cache
def renderer_digest() -> str:
    """Return a hash of the program that renders: its sources, without those of batches and of asset files."""
    root = Path(str(resources.files("lambent_relight")))
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if not name.startswith(("asset/", "batch/")):
            digest.update(f"{name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def _require_path(path: Path | None, identifier: str) -> Path:
    if path is None:
        raise SettingError(
            "batch.not_here", f"{identifier} lies on a server", "fetch it, or run the batch there (--server)"
        )
    return path


def light_digest(light: Light) -> str | Exception:
    """Return the hash of the map's file, or why there is none."""
    try:
        path = _require_path(light.map, light.environment_id)
        if not path.is_file():
            return SettingError("environment.missing", f'there is no file "{path}"', "check the path")
        return file_sha256(path)
    except (RelightError, OSError) as error:
        return error


def _failure(path: str, error: Exception, pointer: str) -> Failure:
    code = error.code if isinstance(error, RelightError) else "batch.io"
    message = f"{error.message}; {error.advice}" if isinstance(error, RelightError) else str(error)
    return Failure(path=path, code=code, message=message, pointer=pointer)


def _check_count(count: int) -> None:
    if count > MAX_PICTURES:
        raise SettingError(
            "batch.too_many", f"more than {MAX_PICTURES} pictures are asked for", "split the manifest"
        )


def check_names(rows: Sequence[Row]) -> None:
    """Raise `batch.same_name` for two pictures, or a picture and a sheet, that are one file somewhere."""
    seen: dict[str, Row] = {}
    for row in rows:
        if _SHEETS.fullmatch(row.path.casefold()):
            raise SettingError(
                "batch.same_name",
                f'the camera "{row.camera.name}" gives the file "{row.path}", which is the contact sheet',
                "rename the camera, or give its pictures another path",
            )
        other = seen.setdefault(row.path.casefold(), row)
        if other is not row:
            raise SettingError(
                "batch.same_name",
                f'two cameras, "{other.camera.name}" and "{row.camera.name}", give the file "{row.path}"',
                "rename one, or split the batch",
            )
