"""turntable: a film of the camera around the object, or of the light around it."""

import shutil
import subprocess
from pathlib import Path
from typing import Annotated, Any

import typer
from PIL import Image

from lambent.cli.output import JsonOption, Output
from lambent.cli.rendering import (
    Look,
    Shot,
    around_object,
    check_choice,
    open_renderer,
    relight_errors,
    render_shots,
)
from lambent.errors import LambentError, UsageProblemError


def turntable(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle folder or zip.")],
    env: Annotated[Path, typer.Option("--env", metavar="MAP", help="Environment map, .exr or .hdr.")],
    output_folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where it goes.")],
    frames: Annotated[int, typer.Option(help="Pictures of one whole turn.", min=2, max=10_000)] = 48,
    turn: Annotated[str, typer.Option(help="camera: around the object; light: around +z.")] = "camera",
    fps: Annotated[int, typer.Option(help="Pictures per second.", min=1, max=120)] = 24,
    film: Annotated[str, typer.Option("--format", help="webp, gif or mp4 (needs ffmpeg).")] = "webp",
    exposure_ev: Annotated[float, typer.Option(help="Brighten by this many stops.")] = 0.0,
    spp: Annotated[int, typer.Option(help="Light directions per pixel.", min=2, max=65536)] = 32,
    seed: Annotated[int, typer.Option(help="Seed of every random number.", min=0)] = 0,
    background: Annotated[str, typer.Option(help="white, environment or transparent.")] = "white",
    size: Annotated[int, typer.Option(help="Side of the pictures, pixels; 0: as photographed.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Render a whole turn into DIR/frames and DIR/turntable.<format>; run again, it goes on."""
    check_choice("--turn", turn, ("camera", "light"))
    check_choice("--format", film, ("webp", "gif", "mp4"))
    if film == "mp4" and shutil.which("ffmpeg") is None:
        raise UsageProblemError(
            "turntable.no_ffmpeg",
            "mp4 needs the ffmpeg program, which is not here",
            "install it, or use webp",
        )
    output = Output(as_json)
    with relight_errors():
        renderer = open_renderer(bundle)
        shots = []
        views = around_object(renderer, frames if turn == "camera" else 1, size=size)
        for index in range(frames):
            angle = 0.0 if turn == "camera" else 360.0 * index / frames
            view = views[index % len(views)]
            name = f"frames/{index:04d}"
            shots.append(Shot(name=name, camera=view, environment=env, rotate_deg=angle))
        look = Look(
            quality="refined",
            num_samples=spp,
            seed=seed,
            exposure_ev=exposure_ev,
            background=background,
            indirect=True,
            antialias=2,
        )
        render_shots(renderer, shots, look, output_folder, output, exr=False)
    target = output_folder / f"turntable.{film}"
    pictures = [output_folder / f"{shot.name}.png" for shot in shots]
    if film == "mp4":
        _write_mp4(output_folder / "frames" / "%04d.png", target, fps)
    else:
        _write_animation(pictures, target, fps)
    output.result(str(target), {"film": str(target)})


def _write_animation(pictures: list[Path], target: Path, fps: int) -> None:
    """Write an endless animation; transparency is kept by both formats."""
    first, *rest = [Image.open(path).convert("RGBA") for path in pictures]
    options: dict[str, Any] = (
        {"lossless": False, "quality": 90, "method": 4} if target.suffix == ".webp" else {"disposal": 2}
    )
    first.save(target, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, **options)


def _write_mp4(pattern: Path, target: Path, fps: int) -> None:
    """Write H.264 with sides made even, which the format demands."""
    command = ["ffmpeg", "-y", "-loglevel", "error", "-framerate", str(fps), "-i", str(pattern)]
    command += ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white", "-pix_fmt", "yuv420p", str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise LambentError(
            "turntable.ffmpeg_failed", done.stderr.strip()[-400:], "the frames are there; try --format webp"
        )
