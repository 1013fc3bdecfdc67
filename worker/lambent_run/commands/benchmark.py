"""The command `lambent benchmark`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from lambent_core.errors import UsageError

from lambent_run.commands import shared
from lambent_run.commands.shared import Json, reporting_errors
from lambent_run.commands.training import parse_settings

if TYPE_CHECKING:
    from lambent_run.benchmark.benchmark import Outcome
    from lambent_run.benchmark.suite import Setting


Scenes = Annotated[list[str] | None, typer.Option(help="Names of scenes; all by default.")]
Ablations = Annotated[
    list[str] | None,
    typer.Option(help="Names with commas, paper, all, or NAME:KEY=VALUE;KEY=VALUE; full is always in."),
]
Lights = Annotated[str, typer.Option(help="single, multi, both, or auto: what the protocol asks for.")]
Environments = Annotated[
    Path | None, typer.Option(help="Folder of maps named like the test lights; else the suite's envmaps.")
]
Devices = Annotated[str, typer.Option(help="cpu, cuda, or several with commas for several jobs.")]
Weights = Annotated[list[Path] | None, typer.Option(help="Weights of LPIPS; repeatable.")]
KeepPredictions = Annotated[
    bool, typer.Option(help="Keep the float maps; a large suite fills a disk with them.")
]
SETTINGS: "dict[str, tuple[Setting, ...] | None]" = {
    "auto": None,
    "single": ("single",),
    "multi": ("multi",),
    "both": ("single", "multi"),
}
"""Numbers of lights to train in, by `--lights`; None: those of the protocol."""


@reporting_errors
def benchmark(
    suite_dir: Annotated[Path, typer.Argument(help="Folder of scenes, or one scene.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for runs, reports and tables.")],
    scenes: Scenes = None,
    preset: Annotated[str, typer.Option(help="Preset of every run.")] = "fast",
    seeds: Annotated[str, typer.Option(help="Seeds, with commas.")] = "0",
    ablations: Ablations = None,
    lights: Lights = "auto",
    environments: Environments = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 1,
    device: Devices = "cpu",
    views: shared.Views = 0,
    repeats: shared.Repeats = 4,
    directions: shared.Directions = 64,
    antialias: shared.Antialias = 2,
    max_side: shared.MaxSide = 0,
    shadows: shared.Shadows = "fast",
    lpips_weights: Weights = None,
    keep_predictions: KeepPredictions = True,
    settings: shared.Settings = None,
    as_json: Json = False,
) -> None:
    """Train and evaluate scenes x seeds x ablations and print the paper's tables; run again to continue."""
    from lambent_core.startup import prepare

    prepare()
    from lambent_run.benchmark.benchmark import run_benchmark
    from lambent_run.benchmark.plan import parse_variants, plan
    from lambent_run.benchmark.suite import find_environments, find_scenes
    from lambent_run.report.request import EvaluationRequest, as_shadows

    request = EvaluationRequest(
        num_views=views,
        num_repeats=repeats,
        num_directions=directions,
        antialias=antialias,
        max_side=max_side,
        shadows=as_shadows(shadows),
        environments=find_environments(suite_dir, environments),
        lpips_weights=tuple(path.resolve() for path in lpips_weights or ()),
    )
    cells = plan(
        find_scenes(suite_dir, _names(scenes)),
        parse_variants(ablations or ()),
        parse_seeds(seeds),
        parse_lights(lights),
        preset=preset,
        overrides=parse_settings(settings or []),
        evaluation=request,
        keep_predictions=keep_predictions,
    )
    outcome = run_benchmark(
        cells,
        out=out,
        preset=preset,
        evaluation=request,
        jobs=jobs,
        devices=tuple(device.split(",")),
        tell=lambda line: typer.echo(json.dumps({"event": line}) if as_json else line, err=not as_json),
    )
    _tell(outcome, out, as_json=as_json)


def _names(scenes: list[str] | None) -> tuple[str, ...]:
    """Return the names of a repeatable option, each of which may hold several with commas."""
    return tuple(name for item in scenes or () for name in item.split(",") if name)


def _tell(outcome: "Outcome", out: Path, *, as_json: bool) -> None:
    """Print the tables, and end with an error where a process has failed."""
    if as_json:
        typer.echo(json.dumps({"tables": str(out / "table.json"), "failed": list(outcome.failed)}))
    else:
        typer.echo(outcome.markdown)
        typer.echo(f"tables: {out / 'table.md'}, table.csv, table.json", err=True)
    if outcome.failed:
        raise typer.Exit(1)


def parse_lights(name: str) -> "tuple[Setting, ...] | None":
    """Return the numbers of lights to train in; raises `UsageError` for an unknown name."""
    if name not in SETTINGS:
        raise UsageError("benchmark.lights_unknown", f'--lights "{name}" is none of {", ".join(SETTINGS)}')
    return SETTINGS[name]


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return seeds from `0,1,2`; raises `UsageError` for anything else."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not parts or not all(part.isdigit() for part in parts):
        raise UsageError("benchmark.seeds", f'--seeds "{text}" must be whole numbers with commas: 0,1,2')
    return tuple(dict.fromkeys(int(part) for part in parts))
