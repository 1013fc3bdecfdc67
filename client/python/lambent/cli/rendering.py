"""What relight and turntable share: opening inputs, cameras around an object, and pictures that resume."""

import hashlib
import json
import os
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from lambent_relight import (
    BundleError,
    Camera,
    MaterialEdit,
    RelightError,
    Renderer,
    load_bundle,
    turntable,
    write_picture_exr,
    write_png,
)
from lambent_relight.environment_input import EnvironmentInput, OpenedEnvironment, open_environment

from lambent.cli.output import Output, format_duration
from lambent.errors import LambentError, UsageProblemError

BACKGROUNDS = {"transparent": "transparent", "environment": "environment", "white": (1.0, 1.0, 1.0)}


@dataclass(frozen=True, kw_only=True, slots=True)
class Shot:
    """One picture to make: `name` is its path in the output folder without a suffix."""

    name: str
    camera: Camera
    environment: Path
    rotate_deg: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Look:
    """How pictures are made: light directions per pixel, PNG exposure in stops, rays along a pixel's side."""

    quality: str
    num_samples: int
    seed: int
    exposure_ev: float
    background: str
    indirect: bool
    antialias: int
    until_stderr: float = 0.0
    edit: MaterialEdit = field(default_factory=MaterialEdit)
    object_rotate_deg: float = 0.0
    light: EnvironmentInput = field(default_factory=EnvironmentInput)


@contextmanager
def relight_errors() -> Iterator[None]:
    """Turn the errors of lambent_relight into the client's: exit code 1 for a bad bundle, else 2."""
    try:
        yield
    except BundleError as error:
        raise LambentError(error.code, error.message, error.advice) from error
    except RelightError as error:
        raise UsageProblemError(error.code, error.message, error.advice) from error


def check_choice(option: str, value: str, choices: Sequence[str]) -> None:
    """Raise `cli.bad_choice` unless `value` is one of `choices`."""
    if value not in choices:
        raise UsageProblemError("cli.bad_choice", f"{option} {value!r}", f"use one of {', '.join(choices)}")


def open_renderer(bundle: Path) -> Renderer:
    """Return a renderer of a checked bundle folder or zip."""
    if not bundle.exists():
        raise UsageProblemError(
            "bundle.missing", f"there is no {bundle}", "fetch one: lambent fetch JOB -o DIR"
        )
    return Renderer(load_bundle(bundle))


def around_object(
    renderer: Renderer, num_views: int, *, size: int = 0, start_deg: float = 0.0
) -> list[Camera]:
    """Return a turntable at the distance, height and field of view of the bundle's own cameras.

    `size` is the side of the square pictures in pixels; 0 takes the longer side of the first camera.
    """
    known = renderer.bundle.cameras()
    bounds = renderer.bundle.manifest.bounds
    target = (np.array(bounds.minimum) + np.array(bounds.maximum)) / 2.0
    offsets = [camera.camera_to_world[:3, 3] - target for camera in known]
    radii = [float(np.linalg.norm(offset)) for offset in offsets]
    elevations = [
        float(np.degrees(np.arcsin(np.clip(offset[2] / radius, -1.0, 1.0))))
        for offset, radius in zip(offsets, radii, strict=True)
    ]
    side = size or max(known[0].width, known[0].height)
    return turntable(
        num_views,
        radius=statistics.median(radii),
        elevation_deg=statistics.median(elevations),
        target=target.tolist(),
        width=side,
        height=side,
        field_of_view_deg=float(np.degrees(2.0 * np.arctan(0.5 * known[0].width / known[0].focal_x))),
        start_deg=start_deg,
    )


def render_shots(
    renderer: Renderer, shots: Sequence[Shot], look: Look, folder: Path, output: Output, *, exr: bool = True
) -> None:
    """Make every picture that is not there yet, and list them in `folder`/pictures.json.

    Files appear whole or not at all; a picture is kept when bundle, light, camera and look are the same.
    """
    check_choice("--background", look.background, tuple(BACKGROUNDS))
    index = folder / "pictures.json"
    records = _read_records(index)
    environments: dict[Path, OpenedEnvironment] = {}
    began, num_made = time.monotonic(), 0
    with _PictureBar(len(shots), output) as bar:
        for number, shot in enumerate(shots):
            files = [folder / f"{shot.name}{suffix}" for suffix in ((".png", ".exr") if exr else (".png",))]
            key = _key(renderer, shot, look)
            if records.get(shot.name, {}).get("key") == key and all(path.is_file() for path in files):
                bar.done(number, shot.name, "kept")
                continue
            if shot.environment not in environments:
                environments[shot.environment] = _load(shot.environment, look.light, output)
            opened = environments[shot.environment]
            picture = renderer.render(
                shot.camera,
                opened.environment,
                rotate_deg=shot.rotate_deg,
                quality=look.quality,
                num_samples=look.num_samples,
                seed=look.seed,
                indirect=look.indirect,
                antialias=look.antialias,
                until_stderr=look.until_stderr,
                edit=look.edit,
                object_rotate_deg=look.object_rotate_deg,
                background=BACKGROUNDS[look.background],
                progress=lambda fraction, number=number: bar.move(number + fraction),
            )
            for path in files:
                partial = path.with_name(f".partial-{path.name}")
                if path.suffix == ".png":
                    write_png(partial, picture.exposed(look.exposure_ev))
                else:
                    write_picture_exr(partial, picture)
                os.replace(partial, path)
            num_made += 1
            records[shot.name] = {
                "key": key,
                "files": [path.relative_to(folder).as_posix() for path in files],
                "camera": shot.camera.name,
                "environment": shot.environment.name,
                "rotate_deg": shot.rotate_deg,
                "num_samples": picture.num_samples,
                "mean_standard_error": float(picture.standard_error.mean()),
                "environment_notes": opened.notes(shot.environment.name),
            }
            _write_records(index, records)
            bar.done(number, shot.name, "made")
    seconds = time.monotonic() - began
    text = f"{folder}  ({num_made} pictures made, {len(shots) - num_made} kept, {format_duration(seconds)})"
    wanted = [records[shot.name] for shot in shots]
    output.result(text, {"path": str(folder), "made": num_made, "pictures": wanted})


def _load(path: Path, light: EnvironmentInput, output: Output) -> OpenedEnvironment:
    opened = open_environment(path, light)
    for note in opened.notes(path.name):
        output.note(note)
    return opened


def _key(renderer: Renderer, shot: Shot, look: Look) -> str:
    if not shot.environment.is_file():
        raise UsageProblemError(
            "environment.missing", f"there is no file {shot.environment}", "check the path"
        )
    with shot.environment.open("rb") as file:
        light = hashlib.file_digest(file, "sha256").hexdigest()
    files = sorted(entry.sha256 for entry in renderer.bundle.manifest.files)
    parts = [*files, light, shot.camera.key().hex(), shot.rotate_deg, repr(look)]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


def _read_records(index: Path) -> dict[str, dict[str, Any]]:
    if not index.is_file():
        return {}
    try:
        return {record["name"]: record for record in json.loads(index.read_text())["pictures"]}
    except (ValueError, KeyError, TypeError) as error:
        raise UsageProblemError(
            "relight.bad_index", f"{index} was not written by this command: {error}", "choose another folder"
        ) from error


def _write_records(index: Path, records: dict[str, dict[str, Any]]) -> None:
    partial = index.with_name(f".partial-{index.name}")
    pictures = [{"name": name, **record} for name, record in sorted(records.items())]
    partial.write_text(json.dumps({"pictures": pictures}, indent=1) + "\n")
    os.replace(partial, index)


class _PictureBar:
    """Progress over pictures: a bar on a terminal, one line per picture elsewhere, nothing with JSON."""

    def __init__(self, total: int, output: Output) -> None:
        import sys

        self._total, self._output, self._bar = total, output, None
        if not output.as_json and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = (
                TextColumn("{task.description}"),
                BarColumn(),
                MofNCompleteColumn(),
                TimeRemainingColumn(),
            )
            self._bar = Progress(*columns, console=Console(stderr=True))
            self._task = self._bar.add_task("relight", total=total)

    def __enter__(self) -> "_PictureBar":
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar:
            self._bar.stop()

    def move(self, done: float) -> None:
        """Show that `done` pictures are made; a fraction while one is on its way."""
        if self._bar:
            self._bar.update(self._task, completed=done)

    def done(self, number: int, name: str, what: str) -> None:
        """Show that picture `number` is there."""
        self.move(number + 1)
        if not self._bar:
            self._output.note(f"{what} {number + 1}/{self._total} {name}")
