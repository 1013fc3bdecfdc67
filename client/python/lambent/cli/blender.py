"""blender: the script that opens a bundle in Blender."""

from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from lambent.cli.output import JsonOption, Output, RotateOption
from lambent.errors import UsageProblemError

_PLACE = "OWN_ARGUMENTS: list[str] = []"


def blender(
    bundle: Annotated[
        Path | None,
        typer.Argument(
            metavar="[BUNDLE]", help="Bundle folder to write into the script, for Blender's text editor."
        ),
    ] = None,
    output_file: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Write the script there; else print it."),
    ] = None,
    env: Annotated[
        Path | None, typer.Option(metavar="MAP", help="Light instead of the recovered one, .exr or .hdr.")
    ] = None,
    rotate_deg: RotateOption = 0.0,
    view: Annotated[int, typer.Option(help="Number of the camera to look through.", min=0)] = 0,
    as_json: JsonOption = False,
) -> None:
    """Write the script that opens a bundle in Blender: mesh, light and cameras with the right axes.

    Without BUNDLE the script takes it as an argument: blender --python FILE -- BUNDLE.
    """
    text = resources.files("lambent_relight").joinpath("asset/blender_import.py").read_text(encoding="utf-8")
    if bundle is not None:
        words = _arguments(bundle, env, rotate_deg, view)
        text = text.replace(_PLACE, f"OWN_ARGUMENTS: list[str] = {words!r}")
    elif env is not None or rotate_deg or view:
        raise UsageProblemError(
            "cli.bad_choice", "--env, --rotate-deg or --view without a bundle", "name the bundle as well"
        )
    output = Output(as_json)
    if output_file is None:
        output.result(text.rstrip("\n"), {"script": text})
        return
    output_file.parent.mkdir(parents=True, exist_ok=True)
    output_file.write_text(text, encoding="utf-8")
    more = "" if bundle is not None else " -- BUNDLE"
    output.result(f"blender --python {output_file}{more}", {"path": str(output_file)})


def _arguments(bundle: Path, env: Path | None, rotate_deg: float, view: int) -> list[str]:
    """Return the script's arguments, paths absolute; raises `bundle.missing` or `environment.missing`."""
    if not (bundle / "mesh" / "asset.glb").is_file():
        raise UsageProblemError(
            "bundle.missing",
            f'"{bundle}" is not a bundle folder with mesh/asset.glb',
            "Blender reads folders: fetch one with lambent fetch JOB -o DIR, or unpack the zip",
        )
    words = [str(bundle.resolve()), "--rotate-deg", str(rotate_deg), "--view", str(view)]
    if env is not None:
        if not env.is_file():
            raise UsageProblemError("environment.missing", f'there is no file "{env}"', "check the path")
        words += ["--env", str(env.resolve())]
    return words
