"""export: the bundle of a trained run, or the asset of a run or bundle in other programs' formats."""

from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer
from lambent_core.errors import pip_install
from lambent_core.pictures import EnvironmentInput

from lambent.cli.output import JsonOption, Output
from lambent.cli.rendering import open_bundle, relight_errors
from lambent.cli.setting_options import takes
from lambent.errors import UsageProblemError

_Glb = Annotated[bool, typer.Option("--glb", help="Write asset.glb, glTF 2.0.")]
_Usdz = Annotated[bool, typer.Option("--usdz", help="Write asset.usdz; needs lambent[usd].")]
_Obj = Annotated[bool, typer.Option("--obj", help="Write obj/asset.obj with materials.")]
_Mitsuba = Annotated[bool, typer.Option("--mitsuba", help="Write mitsuba/scene.xml with light and cameras.")]
_WEBP = "WebP textures in the GLB; readers need EXT_texture_webp."
_KTX2 = "KTX 2 textures in the GLB; readers need KHR_texture_basisu; needs the program basisu."
_DRACO = "Pack the GLB's mesh; readers need KHR_draco_mesh_compression; needs lambent[draco]."
_TIER = "Of a bundle: full, or lite, without networks, for phones."
_WEIGHTS = "Of a bundle: fp16, fp32, none, or auto: fp16 unless that moves the answers."
_MESH = "Of a run's bundle: an edited mesh in place of the trained surface."
_FACES = "Of a bundle: triangles of the mesh; auto: as many as it needs."
_ATLAS = "Of a bundle: side of the albedo texture, or auto: as fine as the photographs."


@takes("given", EnvironmentInput)
def export(
    source: Annotated[
        Path, typer.Argument(metavar="RUN|BUNDLE", help="Folder made by lambent train, or a bundle.")
    ],
    output_folder: Annotated[
        Path,
        typer.Option(
            "-o", "--out", metavar="FOLDER", help="Where files go; for a bundle it must not exist yet."
        ),
    ],
    glb: _Glb = False,
    usdz: _Usdz = False,
    obj: _Obj = False,
    mitsuba: _Mitsuba = False,
    webp: Annotated[bool, typer.Option("--webp", help=_WEBP)] = False,
    ktx2: Annotated[bool, typer.Option("--ktx2", help=_KTX2)] = False,
    draco: Annotated[bool, typer.Option("--draco", help=_DRACO)] = False,
    env: Annotated[
        Path | None,
        typer.Option(metavar="MAP", help="Light of the Mitsuba scene; by default the recovered one."),
    ] = None,
    tier: Annotated[str, typer.Option(help=_TIER)] = "",
    weights: Annotated[str, typer.Option(help=_WEIGHTS)] = "",
    mesh: Annotated[Path | None, typer.Option("--mesh", metavar="FILE.glb", help=_MESH)] = None,
    faces: Annotated[str, typer.Option(metavar="N|auto", help=_FACES)] = "",
    atlas: Annotated[str, typer.Option(metavar="TEXELS", help=_ATLAS)] = "",
    as_json: JsonOption = False,
    *,
    given: EnvironmentInput,
) -> None:
    """Write the relightable bundle of a trained run or, with formats, its asset for other programs."""
    wanted = {"glb": glb, "usdz": usdz, "obj": obj, "mitsuba": mitsuba}
    formats = [name for name, asked in wanted.items() if asked]
    packing = {"webp": webp, "ktx2": ktx2, "draco": draco}
    needs = {f"--{name}": (asked, "glb") for name, asked in packing.items()}
    needs["--env"] = (env is not None, "mitsuba")
    _check_options(needs, formats, for_bundle=bool(tier or weights or mesh or faces or atlas))
    if webp and ktx2:
        raise UsageProblemError("cli.bad_choice", "--webp with --ktx2", "textures are one of the two")
    if formats:
        _export_asset(source, output_folder, formats, env=env, given=given, as_json=as_json, **packing)
        return
    settings = {"tier": tier, "weights": weights, "faces": faces, "atlas": atlas}
    _export_bundle(source, output_folder, mesh=mesh, as_json=as_json, **settings)


def _export_asset(
    source: Path,
    folder: Path,
    formats: list[str],
    *,
    env: Path | None,
    given: EnvironmentInput,
    as_json: bool,
    **packing: bool,
) -> None:
    """Write the asset of a run or bundle in formats of other programs."""
    # These take a moment to import, which the export of a bundle does not pay.
    from lambent_relight.asset.write import write_formats
    from lambent_relight.environment.input import open_environment

    output = Output(as_json)
    with relight_errors():
        bundle = open_bundle(_bundle_of(source))
        light = None if env is None else open_environment(env, given)
        environment = None if light is None else light.environment
        written = write_formats(bundle, folder, formats, environment=environment, **packing)
    for note in light.notes(str(env)) if light is not None else ():
        output.note(note)
    output.result("\n".join(str(path) for path in written), {"files": [str(path) for path in written]})


def _check_options(needs: dict[str, tuple[bool, str]], formats: list[str], *, for_bundle: bool) -> None:
    """Raise `cli.bad_choice` for an option without the format that it belongs to."""
    for option, (given, name) in needs.items():
        if given and name not in formats:
            raise UsageProblemError("cli.bad_choice", f"{option} without --{name}", f"add --{name}")
    if formats and for_bundle:
        raise UsageProblemError(
            "cli.bad_choice",
            f"--tier, --weights, --mesh, --faces and --atlas with --{formats[0]}",
            "they are for a bundle: export that first, without formats, and then its asset",
        )


def _bundle_of(source: Path) -> Path:
    """Return the bundle of a run folder, or `source` itself."""
    if not (source / "run.json").is_file():
        return source
    if not (source / "bundle" / "manifest.json").is_file():
        raise UsageProblemError(
            "export.no_bundle",
            f'the run in "{source}" has no bundle yet',
            "finish it with lambent train --resume",
        )
    return source / "bundle"


def _export_bundle(
    source: Path, output_folder: Path, *, mesh: Path | None, as_json: bool, **settings: str
) -> None:
    """Let the worker's command write the bundle of a run."""
    if (source / "manifest.json").is_file() or source.suffix == ".zip":
        raise UsageProblemError(
            "export.no_format",
            f'"{source}" is a bundle already',
            "say what to write: --glb, --usdz, --obj or --mitsuba",
        )
    try:
        (point,) = entry_points(group="lambent.commands", name="export")
        command = point.load()
    except (ModuleNotFoundError, ValueError) as error:
        raise UsageProblemError(
            "cli.missing_extra",
            "the export of a bundle needs the worker, which is not installed",
            pip_install("worker"),
        ) from error
    command(run_dir=source, out=output_folder, mesh=mesh, as_json=as_json, **settings)
