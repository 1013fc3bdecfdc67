"""Makes single pictures of a batch. It keeps one bundle and one map open, whatever the number of pictures."""

import os
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import cast

from lambent_relight.batch.journal import MadeFile, Record
from lambent_relight.batch.manifest import BACKGROUNDS, Files, Light
from lambent_relight.batch.plan import Row, bundle_digest, light_digest
from lambent_relight.bundle.bundle import load_bundle
from lambent_relight.environment.input import OpenedEnvironment, open_environment
from lambent_relight.errors import BundleError, EnvironmentFileError
from lambent_relight.file_hash import file_sha256
from lambent_relight.images import write_picture_exr, write_png
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.sampling_plan import Bounces
from lambent_relight.renderer import Renderer

KEPT_RAYS = 1_000_000
"""Camera rays whose views are remembered, about 70 MB; other lights of the same cameras find them again."""


class Studio:
    """Renders rows into files of one folder; cheapest where neighbours share bundle, map and camera."""

    def __init__(
        self, folder: Path, files: Files, *, num_threads: int | None = None, kept_rays: int = KEPT_RAYS
    ) -> None:
        self._kept_rays = kept_rays
        self._folder = folder
        self._files = files
        self._num_threads = num_threads
        self._renderer: tuple[Path, str, Renderer] | None = None
        self._light: tuple[Light, str, OpenedEnvironment] | None = None

    def make(
        self, row: Row, suffixes: Collection[str], progress: Callable[[float], None] | None = None
    ) -> Record:
        """Render one picture and write its files with these suffixes; each appears whole or not at all.

        `progress` is called with the finished fraction. Raises RelightError where an input cannot be used.
        """
        began = time.monotonic()
        renderer, opened = self._open_bundle(row), self._open_light(row)
        quality = row.quality
        picture = renderer.render(
            row.camera,
            opened.environment,
            rotate_deg=row.light.rotate_deg,
            quality=quality.quality,
            num_samples=quality.spp,
            seed=quality.seed,
            indirect=quality.indirect,
            bounces=cast(Bounces, quality.bounces),
            antialias=quality.antialias,
            until_stderr=quality.until_stderr,
            edit=row.asset.edit,
            object_rotate_deg=row.asset.object_rotate_deg,
            background=BACKGROUNDS[quality.background],
            progress=progress,
        )
        made = {suffix: self._write(row, suffix, picture) for suffix in suffixes}
        noise, mean = float(picture.standard_error.mean()), float(picture.rgb.mean())
        return Record(
            path=row.path,
            asset=row.asset.name,
            environment=row.light.name,
            quality=quality.name,
            camera=row.camera.name,
            files=made,
            width=row.camera.width,
            height=row.camera.height,
            seconds=time.monotonic() - began,
            num_samples=picture.num_samples,
            mean_standard_error=noise,
            bounces=picture.bounces,
            relative_standard_error=noise / mean if mean > 0.0 else 0.0,
            notes=tuple(opened.notes(row.light.name)),
        )

    def _open_bundle(self, row: Row) -> Renderer:
        path = row.asset.path
        assert path is not None
        known = self._renderer
        if known is None or known[0] != path or known[1] != row.bundle_digest:
            self._renderer = None  # two bundles are never held at once
            bundle = load_bundle(path)
            digest = bundle_digest(bundle)
            if digest != row.bundle_digest:
                raise BundleError(
                    "bundle.changed", f"{path} was changed while the batch ran", "run the batch again"
                )
            renderer = Renderer(bundle, num_threads=self._num_threads, kept_rays=self._kept_rays)
            known = self._renderer = (path, digest, renderer)
        return known[2]

    def _open_light(self, row: Row) -> OpenedEnvironment:
        """Return the map; turning a known one keeps what renderers have prepared of it."""
        light = row.light
        assert light.path is not None
        known = self._light
        same = known is not None and (known[0].path, known[0].given, known[1]) == (
            light.path,
            light.given,
            row.light_digest,
        )
        if known is None or not same:
            self._light = None
            if light_digest(light) != row.light_digest:
                raise EnvironmentFileError(
                    "environment.changed",
                    f"{light.path} is not the file it was when this batch began",
                    "run the batch again",
                )
            known = self._light = (light, row.light_digest, open_environment(light.path, light.given))
        return known[2]

    def _write(self, row: Row, suffix: str, picture: RelitPicture) -> MadeFile:
        relative = f"{row.path}.{suffix}"
        path = self._folder / relative
        partial = path.with_name(f".partial-{os.getpid()}-{path.name}")
        try:
            if suffix == "png":
                shown = picture.exposed(row.quality.exposure_ev)
                write_png(partial, shown, tone_mapping=row.quality.tone_mapping)
            else:
                write_picture_exr(
                    partial,
                    picture,
                    half=self._files.half,
                    passes=self._files.passes,
                    attributes={"lambent:bundle": row.bundle_digest, "lambent:environment": row.light_digest},
                )
            digest = file_sha256(partial)
            size_bytes = partial.stat().st_size
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
        key = row.key(suffix, self._files)
        return MadeFile(path=relative, key=key, sha256=digest, size_bytes=size_bytes)


def remove_partials(folder: Path, rows: Collection[Row]) -> None:
    """Remove half-written files that a killed program left beside the pictures of `rows`."""
    for place in {(folder / row.path).parent for row in rows}:
        for path in place.glob(".partial-*"):
            path.unlink(missing_ok=True)
