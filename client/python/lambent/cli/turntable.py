"""turntable: a film of one turn of the camera, the light or the object."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from lambent_core.pictures import EnvironmentInput, RenderSettings
from lambent_relight import Bundle
from lambent_relight.batch.manifest import Files, Light
from lambent_relight.batch.plan import Row
from lambent_relight.batch.studio import Studio
from lambent_relight.object_cameras import around_object
from PIL import Image

from lambent import film
from lambent.cli.output import BundleArgument, JsonOption, MapOption, Output
from lambent.cli.rendering import (
    PictureBar,
    Shot,
    asset_here,
    check_choice,
    light_here,
    make_pictures,
    open_bundle,
    relight_errors,
    rows_of,
)
from lambent.cli.setting_options import takes
from lambent.errors import UsageProblemError

TURNS = ("camera", "light", "object")
ANIMATIONS = ("webp", "gif")
_OUT = "A film, .mp4 or .webm, or a folder for pictures."


@takes("settings", RenderSettings, spp=32, background="white")
@takes("given", EnvironmentInput)
def turntable(
    bundle: BundleArgument,
    env: MapOption,
    target: Annotated[Path, typer.Option("-o", "--output", metavar="OUT", help=_OUT)],
    frames: Annotated[
        int | None, typer.Option(help="Pictures of one whole turn (48).", min=2, max=100_000)
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Length of one turn, instead of --frames.", min=0.01, max=86_400.0)
    ] = None,
    turn: Annotated[
        str, typer.Option(help="camera: around the object; light: around +z; object: under its light.")
    ] = "camera",
    fps: Annotated[int, typer.Option(help="Pictures per second.", min=1, max=240)] = 24,
    crf: Annotated[
        int | None,
        typer.Option(help="Quality of a film: lower is better and larger (18 for .mp4, 24 for .webm)."),
    ] = None,
    animation: Annotated[
        str, typer.Option("--format", help="webp, gif, mp4, webm or none: a film beside a folder's pictures.")
    ] = "webp",
    size: Annotated[int, typer.Option(help="Side of the pictures, pixels; 0: as photographed.")] = 0,
    rotate_deg: Annotated[
        float, typer.Option(help="Turn the light by this angle about +z before anything else, degrees.")
    ] = 0.0,
    probes: Annotated[
        bool, typer.Option("--probes", help="Draw a chrome and a grey ball into the lower left corner.")
    ] = False,
    as_json: JsonOption = False,
    *,
    settings: RenderSettings,
    given: EnvironmentInput,
) -> None:
    """Render a whole turn: straight into a film, or into DIR/frames and DIR/turntable.<format>.

    A folder's pictures resume: run again, only what is missing or has changed is made.
    """
    check_choice("--turn", turn, TURNS)
    check_choice("--format", animation, (*ANIMATIONS, *(suffix[1:] for suffix in film.SUFFIXES), "none"))
    count = _num_frames(frames, seconds, fps)
    straight = bool(target.suffix) and not target.is_dir()
    whole = target if straight else target / f"turntable.{animation}"
    if straight or f".{animation}" in film.SUFFIXES:
        _check_film(whole, crf, settings)
    elif crf is not None:
        raise UsageProblemError("cli.bad_choice", f"--crf with {animation}", "use it for .mp4 and .webm")
    output = Output(as_json)
    files = Files.model_construct(files=["png"], linear=not straight, probes=probes)
    with relight_errors():
        opened = open_bundle(bundle)
        shots = shots_of_turn(opened, light_here(env, given), turn, count, size=size, rotate_deg=rotate_deg)
        rows = rows_of(shots, opened, asset_here(bundle), settings)
        if straight:
            _stream(rows, files, film.FilmWriter(target, fps=fps, crf=crf), output)
        else:
            make_pictures(rows, files, target, output)
    if animation == "none" and not straight:
        whole = target
    elif not straight:
        _join([target / f"{row.path}.png" for row in rows], whole, fps, crf)
    output.result(str(whole), {"film": str(whole), "frames": count, "fps": fps})


def shots_of_turn(
    bundle: Bundle, light: Light, turn: str, count: int, *, size: int = 0, rotate_deg: float = 0.0
) -> list[Shot]:
    """Return the pictures of one whole turn, counter-clockwise as seen from above; `turn` is one of `TURNS`.

    The object turns about the middle of its box: the camera goes the other way, and the light with it.
    """
    views = around_object(bundle, 1 if turn == "light" else count, size=size)
    shots = []
    for index in range(count):
        angle = 360.0 * index / count
        view = views[{"camera": index, "light": 0, "object": -index % count}[turn]]
        light_deg = rotate_deg + {"camera": 0.0, "light": angle, "object": -angle}[turn]
        turned = light.model_copy(update={"rotate_deg": light_deg})
        shots.append(Shot(path=f"frames/{index:04d}", light=turned, camera=view))
    return shots


def _check_film(path: Path, crf: int | None, settings: RenderSettings) -> None:
    film.check_film(path, crf)
    if settings.background == "transparent":
        raise UsageProblemError(
            "turntable.no_alpha", f"{path.name} cannot be transparent", "use --format webp, or white"
        )


def _num_frames(frames: int | None, seconds: float | None, fps: int) -> int:
    if frames is not None and seconds is not None:
        raise UsageProblemError("cli.bad_choice", "--frames and --seconds", "give one of them")
    if seconds is None:
        return frames or 48
    return max(math.floor(seconds * fps + 0.5), 2)


def _stream(rows: Sequence[Row], files: Files, writer: film.FilmWriter, output: Output) -> None:
    """Render pictures straight into a film."""
    # No view is seen twice, but for the one that a turning light is looked at from.
    studio = Studio(Path(), files, kept_rays=0)
    for note in studio.notes(rows[0]):
        output.note(note)
    with writer, PictureBar(len(rows), output) as bar:
        for number, row in enumerate(rows):

            def advance(fraction: float, before: int = number) -> None:
                bar.move(before + fraction)

            writer.add(studio.frame(row, advance)[..., :3])
            bar.done(number, f"{number + 1}", "made")


def _join(pictures: list[Path], target: Path, fps: int, crf: int | None) -> None:
    """Write a film of pictures, or an endless animation, both formats of which keep transparency."""
    if target.suffix in film.SUFFIXES:
        with film.FilmWriter(target, fps=fps, crf=crf) as writer:
            for path in pictures:
                with Image.open(path) as image:
                    writer.add(np.asarray(image.convert("RGB")))
        return
    first, *rest = [Image.open(path).convert("RGBA") for path in pictures]
    options: dict[str, Any] = (
        {"lossless": False, "quality": 90, "method": 4} if target.suffix == ".webp" else {"disposal": 2}
    )
    first.save(target, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, **options)
