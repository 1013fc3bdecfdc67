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
    glb: Annotated[bool, typer.Option("--glb", help="Write asset.glb, glTF 2.0.")] = False,
    usdz: Annotated[bool, typer.Option("--usdz", help="Write asset.usdz; needs lambent[usd].")] = False,
    obj: Annotated[bool, typer.Option("--obj", help="Write obj/asset.obj with materials.")] = False,
    mitsuba: Annotated[
        bool, typer.Option("--mitsuba", help="Write mitsuba/scene.xml with light and cameras.")
    ] = False,
    webp: Annotated[
        bool, typer.Option("--webp", help="WebP textures in the GLB; readers need EXT_texture_webp.")
    ] = False,
    ktx2: Annotated[
        bool,
        typer.Option(
            "--ktx2",
            help="KTX 2 textures in the GLB; readers need KHR_texture_basisu; needs the program basisu.",
        ),
    ] = False,
    draco: Annotated[
        bool,
        typer.Option(
            "--draco",
            help="Pack the GLB's mesh; readers need KHR_draco_mesh_compression; needs lambent[draco].",
        ),
    ] = False,
    env: Annotated[
        Path | None,
        typer.Option(metavar="MAP", help="Light of the Mitsuba scene; by default the recovered one."),
    ] = None,
    tier: Annotated[str, typer.Option(help="Of a bundle: full, or lite, without networks, for phones.")] = "",
    weights: Annotated[
        str, typer.Option(help="Of a bundle: fp16, fp32, none, or auto: fp16 unless that moves the answers.")
    ] = "",
    mesh: Annotated[
        Path | None,
        typer.Option(
            "--mesh",
            metavar="FILE.glb",
            help="Of a run's bundle: an edited mesh in place of the trained surface.",
        ),
    ] = None,
    faces: Annotated[
        str,
        typer.Option(metavar="N|auto", help="Of a bundle: triangles of the mesh; auto: as many as it needs."),
    ] = "",
    atlas: Annotated[
        str,
        typer.Option(
            metavar="TEXELS",
            help="Of a bundle: side of the albedo texture, or auto: as fine as the photographs.",
        ),
    ] = "",
    as_json: JsonOption = False,
    *,
    given: EnvironmentInput,
) -> None:
    """Write the relightable bundle of a trained run or, with formats, its asset for other programs."""
    wanted = {"glb": glb, "usdz": usdz, "obj": obj, "mitsuba": mitsuba}
    formats = [name for name, asked in wanted.items() if asked]
    _check_options(
        {
            "--webp": (webp, "glb"),
            "--ktx2": (ktx2, "glb"),
            "--draco": (draco, "glb"),
            "--env": (env is not None, "mitsuba"),
        },
        formats,
        for_bundle=bool(tier or weights or mesh or faces or atlas),
    )
    if webp and ktx2:
        raise UsageProblemError("cli.bad_choice", "--webp with --ktx2", "textures are one of the two")
    if not formats:
        settings = {"tier": tier, "weights": weights, "faces": faces, "atlas": atlas}
        _export_bundle(source, output_folder, mesh=mesh, as_json=as_json, **settings)
        return
    # These take a moment to import, which the export of a bundle does not pay.
    from lambent_relight.asset.write import write_formats
    from lambent_relight.environment.input import open_environment

    with relight_errors():
        bundle = open_bundle(_bundle_of(source))
        light = open_environment(env, given) if env is not None else None
        written = write_formats(
            bundle,
            output_folder,
            formats,
            environment=light.environment if light is not None else None,
            webp=webp,
            ktx2=ktx2,
            draco=draco,
        )
    output = Output(as_json)
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
