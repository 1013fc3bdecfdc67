"""What relight and turntable share: opening inputs, cameras around an object, and pictures that resume."""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lambent_relight import (
    BundleError,
    Camera,
    MaterialEdit,
    RelightError,
    Renderer,
    load_bundle,
    write_picture_exr,
    write_png,
)
from lambent_relight.batch.manifest import BACKGROUNDS
from lambent_relight.bundle import object_cameras
from lambent_relight.environment.input import EnvironmentInput, OpenedEnvironment, open_environment
from lambent_relight.environment.maps import Environment
from lambent_relight.picture import RelitPicture
from lambent_relight.refined.sampling_plan import Bounces
from lambent_relight.renderer import KEPT_RAYS

from lambent.cli.output import Output, format_duration
from lambent.errors import LambentError, UsageProblemError
from lambent.file_hash import file_sha256

if TYPE_CHECKING:
    from lambent_relight.probe_overlay import LightProbes


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
    tone_mapping: str = "linear"
    bounces: Bounces = "auto"
    probes: bool = False
    """Whether a chrome and a grey ball stand in the PNG's corner."""


_BOUNCES = {
    "": "without bounced light",
    "adapted": "bounced light from the fast cache that was adapted to it",
    "transport": "bounced light from baked transport",
    "one": "light that bounced once",
}


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


def open_renderer(bundle: Path, *, kept_rays: int = KEPT_RAYS) -> Renderer:
    """Return a renderer of a checked bundle folder or zip; `kept_rays` as in `Renderer`."""
    if not bundle.exists():
        raise UsageProblemError(
            "bundle.missing", f"there is no {bundle}", "fetch one: lambent fetch JOB -o DIR"
        )
    return Renderer(load_bundle(bundle), kept_rays=kept_rays)


def around_object(
    renderer: Renderer, num_views: int, *, size: int = 0, start_deg: float = 0.0
) -> list[Camera]:
    """Return a turntable at the distance, height and field of view of the bundle's own cameras.

    `size` is the side of the square pictures in pixels; 0 takes the longer side of the first camera.
    """
    return object_cameras.around_object(renderer.bundle, num_views, size=size, start_deg=start_deg)


def render_shot(
    renderer: Renderer,
    shot: Shot,
    look: Look,
    environment: Environment,
    progress: Callable[[float], None],
) -> RelitPicture:
    """Return one picture made as `look` says, linear radiance; `progress` is told the share that is done."""
    return renderer.render(
        shot.camera,
        environment,
        rotate_deg=shot.rotate_deg,
        quality=look.quality,
        num_samples=look.num_samples,
        seed=look.seed,
        indirect=look.indirect,
        antialias=look.antialias,
        until_stderr=look.until_stderr,
        bounces=look.bounces,
        edit=look.edit,
        object_rotate_deg=look.object_rotate_deg,
        background=BACKGROUNDS[look.background],
        progress=progress,
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
    hashes: dict[Path, str] = {}
    probes = ProbeDrawer(look)
    told: set[tuple[Path, str]] = set()
    began, num_made = time.monotonic(), 0
    with PictureBar(len(shots), output) as bar:
        for number, shot in enumerate(shots):
            files = [folder / f"{shot.name}{suffix}" for suffix in ((".png", ".exr") if exr else (".png",))]
            if shot.environment not in hashes:
                hashes[shot.environment] = _light_hash(shot.environment)
            key = _key(renderer, shot, hashes[shot.environment], look)
            if records.get(shot.name, {}).get("key") == key and all(path.is_file() for path in files):
                bar.done(number, shot.name, "kept")
                continue
            if shot.environment not in environments:
                environments[shot.environment] = _load(shot.environment, look.light, output)
            opened = environments[shot.environment]
            picture = render_shot(
                renderer,
                shot,
                look,
                opened.environment,
                lambda fraction, number=number: bar.move(number + fraction),
            )
            shown = probes.over(picture, shot, opened.environment)
            for path in files:
                partial = path.with_name(f".partial-{path.name}")
                if path.suffix == ".png":
                    write_png(partial, shown.exposed(look.exposure_ev), tone_mapping=look.tone_mapping)
                else:
                    write_picture_exr(partial, picture)
                os.replace(partial, path)
            num_made += 1
            if look.quality == "refined" and (shot.environment, picture.bounces) not in told:
                told.add((shot.environment, picture.bounces))
                output.note(f"{shot.environment.name}: {_BOUNCES[picture.bounces.partition(':')[0]]}")
            records[shot.name] = {
                "key": key,
                "files": [path.relative_to(folder).as_posix() for path in files],
                "camera": shot.camera.name,
                "environment": shot.environment.name,
                "rotate_deg": shot.rotate_deg,
                "num_samples": picture.num_samples,
                "bounces": picture.bounces,
                "mean_standard_error": float(picture.standard_error.mean()),
                "environment_notes": opened.notes(shot.environment.name),
            }
            _write_records(index, records)
            bar.done(number, shot.name, "made")
    seconds = time.monotonic() - began
    text = f"{folder}  ({num_made} pictures made, {len(shots) - num_made} kept, {format_duration(seconds)})"
    wanted = [records[shot.name] for shot in shots]
    output.result(text, {"path": str(folder), "made": num_made, "pictures": wanted})


class ProbeDrawer:
    """Draws the balls that a look asks for, if it does."""

    def __init__(self, look: Look) -> None:
        self._wanted = look.probes
        self._known: tuple[Path, LightProbes] | None = None

    def over(self, picture: RelitPicture, shot: Shot, environment: Environment) -> RelitPicture:
        """Return the picture of a shot with its balls."""
        if not self._wanted:
            return picture
        if self._known is None or self._known[0] != shot.environment:
            # Compiled code takes a moment to import, which pictures without balls do not pay.
            from lambent_relight.probe_overlay import LightProbes

            self._known = (shot.environment, LightProbes(environment))
        return self._known[1].over(picture, shot.camera, rotate_deg=shot.rotate_deg)


def _load(path: Path, light: EnvironmentInput, output: Output) -> OpenedEnvironment:
    opened = open_environment(path, light)
    for note in opened.notes(path.name):
        output.note(note)
    return opened


def _light_hash(path: Path) -> str:
    if not path.is_file():
        raise UsageProblemError("environment.missing", f"there is no file {path}", "check the path")
    return file_sha256(path)


def _key(renderer: Renderer, shot: Shot, light: str, look: Look) -> str:
    """Return a hash of everything that a picture is made from; `light` is that of the map's file."""
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


class PictureBar:
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

    def __enter__(self) -> "PictureBar":
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
