"""The commands that need no server: train, evaluate, export. Torch is imported only when they run."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from lambent_core.errors import UsageError
from lambent_core.measured import measured

from lambent_run.commands import shared
from lambent_run.commands.shared import Device, Json, Layout, reporting_errors, stopping_on_signals

if TYPE_CHECKING:
    from lambent_run.run.spec import RunSpec


Scene = Annotated[Path, typer.Argument(help="Folder of a capture, or of photographs.")]
RunFolder = Annotated[Path, typer.Option("--out", "-o", help="Run folder; made if it does not exist.")]
Preset = Annotated[
    str, typer.Option(help="tiny, quick, fast, long, standard, paper_*, or as in paper_tensoir:lego.")
]
Lights = Annotated[str, typer.Option(help="Training light, or several with commas.")]
Rotated = Annotated[
    bool, typer.Option("--rotated", help="The lights are one, turned by the angles in their names.")
]
KnownLights = Annotated[
    list[str] | None,
    typer.Option(metavar="[LIGHT=]FILE", help="A light's environment, .hdr or .exr; repeatable."),
]
LightFixedTo = Annotated[
    str, typer.Option(help="What the light stood still with: auto, scene, camera or room (a turntable).")
]
GreyCard = Annotated[
    str,
    typer.Option(
        metavar="PHOTOGRAPH:X,Y,W,H[:R]",
        help="Where a photograph shows a grey card, pixels, and its reflectance (0.18).",
    ),
]
NoMasks = Annotated[
    bool, typer.Option("--no-masks", help="Without masks, take everything in view for the object.")
]
Corrections = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Corrections of estimated masks; by default those of the run folder."),
]
Ranks = Annotated[
    int, typer.Option(min=1, help="Processes that divide the training, with --device cuda a GPU each.")
]
Resume = Annotated[bool, typer.Option(help="Take all settings from the run folder.")]
DryRun = Annotated[
    bool, typer.Option("--dry-run", help="Only print steps, rays and the memory they would take.")
]


@reporting_errors
def train(
    scene_dir: Scene,
    out: RunFolder,
    preset: Preset = "fast",
    light: Lights = "",
    rotated: Rotated = False,
    known_light: KnownLights = None,
    light_fixed_to: LightFixedTo = "auto",
    grey_card: GreyCard = "",
    layout: Layout = "",
    masks: shared.Masks = None,
    no_masks: NoMasks = False,
    corrections: Corrections = None,
    seed: shared.Seed = 0,
    device: Device = "",
    threads: shared.Threads = 0,
    ranks: Ranks = 1,
    settings: shared.Settings = None,
    resume: Resume = False,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Train on a capture and write a relightable bundle; run again to continue after a stop."""
    from lambent_core.startup import prepare

    prepare(threads)
    from lambent_run.run.spec import RunSpec, with_kept_corrections

    overrides = {"model.environment.lights": "rotated"} if rotated else {}
    overrides |= parse_settings(settings or [])
    lights = tuple(name for name in light.split(",") if name)
    if dry_run:
        _tell_plan(preset, overrides, num_lights=max(1, len(lights)), device=device, as_json=as_json)
        return
    if resume:
        spec = _resumed(out, scene_dir, preset, overrides)
    else:
        spec = RunSpec.from_options(
            scene_dir,
            preset=preset,
            overrides=overrides,
            lights=lights,
            layout=layout,
            known_lights=known_light or (),
            masks=masks,
            whole_view=no_masks,
            light_fixed_to=light_fixed_to,
            corrections=corrections,
            grey_card=grey_card,
            seed=seed,
        )
        if corrections is None:
            spec = with_kept_corrections(spec, out)
    _train(spec, out, device, ranks, as_json=as_json)


def _tell_plan(
    preset: str, overrides: Mapping[str, str], *, num_lights: int, device: str, as_json: bool
) -> None:
    from lambent_run.run.memory_plan import as_text, plan
    from lambent_run.run.settings import config_for

    sizes = plan(config_for(preset, overrides), num_lights=num_lights, device=device)
    typer.echo(json.dumps(sizes) if as_json else as_text(sizes))


def _resumed(out: Path, scene_dir: Path, preset: str, overrides: Mapping[str, str]) -> "RunSpec":
    from lambent_run.run.settings import config_for
    from lambent_run.run.spec import read_run

    spec = replace(read_run(out)[0], scene=scene_dir)
    if spec.config is None:  # photographs that were only prepared so far
        spec = replace(spec, config=config_for(preset, overrides), preset=preset)
    return spec


def _train(spec: "RunSpec", out: Path, device: str, ranks: int, *, as_json: bool) -> None:
    from lambent_run.console_reporter import ConsoleReporter
    from lambent_run.run.pipeline import run_pipeline
    from lambent_run.run.prepare import device_for

    device = device_for(out, device, ranks)
    with ConsoleReporter(out, as_json=as_json) as reporter, stopping_on_signals(reporter.request_stop):
        run_pipeline(spec, out, device, reporter, num_ranks=ranks)
    if not as_json:
        typer.echo(f"bundle: {out / 'bundle'}")
        typer.echo(f"report: {out / 'evaluation' / 'report.html'}")


@reporting_errors
def evaluate(
    run_dir: Annotated[Path, typer.Argument(help="Folder made by lambent train.")],
    scene_dir: Annotated[Path, typer.Argument(help="The capture, or another one of the same object.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for predictions and reports.")],
    environments: Annotated[
        Path | None,
        typer.Option(help="Folder of .hdr or .exr maps named like the scene's lights, to relight with."),
    ] = None,
    views: shared.Views = 0,
    repeats: shared.Repeats = 4,
    directions: shared.Directions = 64,
    antialias: shared.Antialias = 2,
    max_side: shared.MaxSide = 0,
    shadows: shared.Shadows = "fast",
    lpips_weights: Annotated[
        list[Path] | None,
        typer.Option(help="Weights of LPIPS, .safetensors or .pth; repeat for backbone and linear layers."),
    ] = None,
    exr: Annotated[bool, typer.Option("--exr", help="Also write pictures as linear EXR with noise.")] = False,
    device: Device = "",
    as_json: Json = False,
) -> None:
    """Render test views, relight them, compare with the truth: report.json, report.html, pred/."""
    from lambent_core.startup import prepare

    prepare()
    from lambent_run.console_reporter import ConsoleReporter
    from lambent_run.report.request import EvaluationRequest, as_shadows
    from lambent_run.run.evaluation import evaluate_run

    request = EvaluationRequest(
        num_views=views,
        num_repeats=repeats,
        num_directions=directions,
        antialias=antialias,
        environments=environments,
        max_side=max_side,
        shadows=as_shadows(shadows),
        lpips_weights=tuple(lpips_weights or ()),
        exr=exr,
    )
    with ConsoleReporter(as_json=as_json) as reporter, stopping_on_signals(reporter.request_stop):
        report = evaluate_run(run_dir, scene_dir, out, request, device=device, reporter=reporter)
    if not as_json:
        for metric in report.metrics:
            # Figures of pictures in single lights are in the report.
            if metric.name.count("/") == 1 or metric.name.startswith("environment/"):
                unit = "" if metric.unit == "1" else f" {metric.unit}"
                value, error = measured(metric.value, 3), measured(metric.standard_error, 3)
                typer.echo(f"{metric.name:32s} {value:>9} +- {error}{unit}")
        for row in report.absent:
            typer.echo(f"{row.name:32s}         - {row.reason}")
        typer.echo(f"report: {out / 'report.html'}")


@reporting_errors
def export(
    run_dir: Annotated[Path, typer.Argument(help="Folder made by lambent train.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Bundle folder; must not exist yet.")],
    tier: Annotated[
        str, typer.Option(help="full, or lite: less baked transport and no networks, for phones.")
    ] = "",
    weights: Annotated[
        str, typer.Option(help="fp16, fp32, none, or auto: fp16 unless that moves the answers.")
    ] = "",
    mesh: Annotated[
        Path | None,
        typer.Option(metavar="FILE.glb", help="Put an edited mesh in place of the trained surface."),
    ] = None,
    faces: Annotated[
        str, typer.Option(metavar="N|auto", help="Triangles of the mesh; auto: as many as it needs.")
    ] = "",
    atlas: Annotated[
        str,
        typer.Option(
            metavar="TEXELS",
            help="Side of the albedo texture, or auto: as many texels as the photographs have pixels there.",
        ),
    ] = "",
    as_json: Json = False,
) -> None:
    """Write the relightable bundle of a trained run into a folder of its own."""
    from lambent_core.startup import prepare

    prepare()
    from lambent_run.console_reporter import ConsoleReporter
    from lambent_run.run.given_mesh import export_given_mesh
    from lambent_run.run.prepare import export_run

    if mesh is not None and weights not in ("", "none"):
        raise UsageError(
            "mesh_file.no_networks",
            f"--mesh with --weights {weights}: networks know only the trained shape; leave --weights out",
        )
    if mesh is not None and faces:
        raise UsageError(
            "mesh_file.own_shape",
            f"--mesh with --faces {faces}: the triangles are the file's; leave --faces out",
        )
    with ConsoleReporter(as_json=as_json) as reporter, stopping_on_signals(reporter.request_stop):
        if mesh is None:
            export_run(run_dir, out, reporter, tier=tier, weights=weights, faces=faces, atlas=atlas)
        else:
            export_given_mesh(run_dir, out, mesh, reporter, tier=tier, atlas=atlas)
    if not as_json:
        typer.echo(f"bundle: {out}")


def parse_settings(items: list[str]) -> dict[str, str]:
    """Return `KEY=VALUE` items as a mapping; raises `UsageError` for one without a key or an equals sign."""
    parsed: dict[str, str] = {}
    for item in items:
        key, equals, value = item.partition("=")
        if not key or not equals:
            raise UsageError("config.setting_syntax", f'--set "{item}" must look like stage_one.num_rays=512')
        parsed[key] = value
    return parsed
