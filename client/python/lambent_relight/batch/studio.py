"""Makes single pictures of a batch, with one bundle and one map open at a time."""

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from lambent_core.errors import BundleError, EnvironmentFileError
from lambent_core.files import file_sha256, whole_file
from numpy.typing import NDArray

from lambent_relight.batch.journal import MadeFile, Record
from lambent_relight.batch.manifest import LINEAR, Files, place
from lambent_relight.batch.plan import Row, bundle_digest, light_digest
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.environment.input import OpenedEnvironment, open_environment
from lambent_relight.environment.maps import Environment
from lambent_relight.images import encode_png, read_picture_exr, write_picture_exr, write_png
from lambent_relight.picture import Image, RelitPicture
from lambent_relight.renderer import Renderer, with_background

if TYPE_CHECKING:
    from lambent_relight.probe_overlay import LightProbes

_KEPT = ("rgb", "standard_error", "coverage")
KEPT_RAYS = 1_000_000
"""Camera rays whose views are remembered, about 70 MB, or 256 MB of baked views; other lights of the same
cameras find them again."""


class Studio:
    """Renders rows into files of one folder; cheapest where neighbours share bundle, map and camera."""

    def __init__(
        self, folder: Path, files: Files, *, num_threads: int | None = None, kept_rays: int = KEPT_RAYS
    ) -> None:
        self._kept_rays = kept_rays
        self._folder = folder
        self._files = files
        self._num_threads = num_threads
        self._renderer: tuple[tuple[Path, str], Renderer] | None = None
        self._light: tuple[tuple[object, ...], OpenedEnvironment] | None = None
        self._probes: tuple[Environment, LightProbes] | None = None

    def make(
        self, row: Row, suffixes: Collection[str], progress: Callable[[float], None] | None = None
    ) -> Record:
        """Render one picture and write its files with these suffixes; each appears whole or not at all.

        `progress` is called with the finished fraction. Raises RelightError where an input cannot be used.
        """
        began = time.monotonic()
        kept = self._files.linear and LINEAR not in suffixes
        linear, notes = self._read_linear(row) if kept else self._render(row, progress)
        picture = self._before_background(row, linear)
        made = {}
        for suffix in suffixes:
            made[suffix] = self._write(row, suffix, picture if suffix != LINEAR else linear, notes, kept=kept)
        noise, mean = float(picture.standard_error.mean()), float(picture.rgb.mean())
        return Record(
            **row.names(),
            files=made,
            width=row.camera.width,
            height=row.camera.height,
            seconds=time.monotonic() - began,
            num_samples=picture.num_samples,
            mean_standard_error=noise,
            rotate_deg=row.light.rotate_deg,
            bounces=picture.bounces,
            relative_standard_error=noise / mean if mean > 0.0 else 0.0,
            notes=notes,
        )

    def frame(self, row: Row, progress: Callable[[float], None] | None = None) -> NDArray[np.uint8]:
        """Return the pixels of one picture's PNG; nothing is written."""
        linear, _ = self._render(row, progress)
        shown = self._shown(row, self._before_background(row, linear))
        return encode_png(shown, tone_mapping=row.quality.tone_mapping)

    def notes(self, row: Row) -> tuple[str, ...]:
        """Return notes for the user about the map of a picture."""
        return tuple(self._open_light(row).notes(row.light.called))

    def _render(
        self, row: Row, progress: Callable[[float], None] | None
    ) -> tuple[RelitPicture, tuple[str, ...]]:
        """Return the picture without background, and notes for the user about its map."""
        renderer, opened = self._open_bundle(row), self._open_light(row)
        picture = renderer.render(
            row.camera,
            opened.environment,
            row.before("transparent").quality,
            rotate_deg=row.light.rotate_deg,
            object_rotate_deg=row.asset.object_rotate_deg,
            edit=row.asset.edit,
            progress=progress,
        )
        return picture, self.notes(row)

    def _before_background(self, row: Row, linear: RelitPicture) -> RelitPicture:
        name = row.quality.background
        if name == "transparent":
            return linear
        turned = (row.light.rotate_deg, row.asset.object_rotate_deg)
        return with_background(linear, name, row.camera, self._open_light(row).environment, *turned)

    def _shown(self, row: Row, picture: RelitPicture) -> RelitPicture:
        """Return the picture as its PNG shows it, before the tone curve."""
        if self._files.probes:
            environment = self._open_light(row).environment
            if self._probes is None or self._probes[0] is not environment:
                # Compiled code takes a moment to import, which pictures without balls do not pay.
                from lambent_relight.probe_overlay import LightProbes

                self._probes = (environment, LightProbes(environment))
            picture = self._probes[1].over(picture, row.camera, rotate_deg=row.light.rotate_deg)
        return picture.exposed(row.quality.exposure_ev)

    def _read_linear(self, row: Row) -> tuple[RelitPicture, tuple[str, ...]]:
        """Return the kept linear picture; its passes are left out, its EXR has them."""
        with np.load(self._folder / place(row.path, LINEAR)) as kept:
            planes = {}
            for name in _KEPT:
                planes[name] = np.zeros((*kept["seen"].shape, kept[name].shape[1]), np.float32)
                planes[name][kept["seen"]] = kept[name]
            left_out = np.empty((0, 0, 0), np.float32)
            passes = {each.name: left_out for each in fields(RelitPicture) if each.type == Image}
            picture = RelitPicture(
                **{**passes, **planes, "opacity": planes["coverage"]},
                num_samples=int(kept["num_samples"]),
                bounces=str(kept["bounces"]),
                camera_attributes=row.camera.exr_attributes(),
            )
            return picture, tuple(str(note) for note in kept["notes"])

    def _open_bundle(self, row: Row) -> Renderer:
        path = row.asset.bundle
        assert path is not None
        key = (path, row.bundle_digest)
        if self._renderer is None or self._renderer[0] != key:
            self._renderer = None  # two bundles are never held at once
            bundle = load_bundle(path)
            if bundle_digest(bundle) != row.bundle_digest:
                raise BundleError(
                    "bundle.changed", f"{path} was changed while the batch ran", "run the batch again"
                )
            renderer = Renderer(bundle, num_threads=self._num_threads, kept_rays=self._kept_rays)
            self._renderer = (key, renderer)
        return self._renderer[1]

    def _open_light(self, row: Row) -> OpenedEnvironment:
        """Return the map; turning a known one keeps what renderers have prepared of it."""
        light = row.light
        assert light.map is not None
        key = (light.map, light.given, row.light_digest)
        if self._light is None or self._light[0] != key:
            self._light = None
            if light_digest(light) != row.light_digest:
                raise EnvironmentFileError(
                    "environment.changed",
                    f"{light.map} is not the file it was when this batch began",
                    "run the batch again",
                )
            self._light = (key, open_environment(light.map, light))
        return self._light[1]

    def _write(
        self, row: Row, suffix: str, picture: RelitPicture, notes: Sequence[str], *, kept: bool
    ) -> MadeFile:
        relative = place(row.path, suffix)
        path = self._folder / relative
        with whole_file(path) as partial:
            if suffix == "png":
                write_png(partial, self._shown(row, picture), tone_mapping=row.quality.tone_mapping)
            elif suffix == LINEAR:
                _write_linear(partial, picture, notes)
            else:
                write_picture_exr(
                    partial,
                    picture,
                    half=self._files.half,
                    passes=() if kept else self._files.passes,
                    attributes={"lambent:bundle": row.bundle_digest, "lambent:environment": row.light_digest},
                    layers=read_picture_exr(path) if kept else None,
                    object_name=row.asset.called,
                )
            digest = file_sha256(partial)
            size_bytes = partial.stat().st_size
        key = row.key(suffix, self._files)
        return MadeFile(path=relative, key=key, sha256=digest, size_bytes=size_bytes)


def _write_linear(path: Path, picture: RelitPicture, notes: Sequence[str]) -> None:
    """Keep what backgrounds, exposures and curves are applied to, exactly; the empty pixels are left out."""
    planes = {name: getattr(picture, name) for name in _KEPT}
    seen = np.any([plane.any(axis=-1) for plane in planes.values()], axis=0)
    with path.open("wb") as file:
        np.savez(
            file,
            seen=seen,
            **{name: plane[seen] for name, plane in planes.items()},
            num_samples=picture.num_samples,
            bounces=picture.bounces,
            notes=np.array(notes, dtype=np.str_),
        )


def remove_partials(folder: Path, rows: Collection[Row]) -> None:
    """Remove half-written files that a killed program left beside the pictures of `rows`."""
    for home in {(folder / place(row.path, suffix)).parent for row in rows for suffix in ("png", LINEAR)}:
        for path in home.glob(".partial-*"):
            path.unlink(missing_ok=True)
