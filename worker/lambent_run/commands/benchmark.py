"""The command `lambent benchmark`."""

import json
from pathlib import Path
from typing import Annotated, cast

import typer
from lambent_core.errors import UsageError

from lambent_run.commands import shared
from lambent_run.commands.shared import Json, reporting_errors
from lambent_run.commands.training import parse_settings


@reporting_errors
def benchmark(
    suite_dir: Annotated[Path, typer.Argument(help="Folder of scenes, or one scene.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for runs, reports and tables.")],
    scenes: Annotated[list[str] | None, typer.Option(help="Names of scenes; all by default.")] = None,
    preset: Annotated[str, typer.Option(help="Preset of every run.")] = "fast",
    seeds: Annotated[str, typer.Option(help="Seeds, with commas.")] = "0",
    ablations: Annotated[
        list[str] | None,
        typer.Option(help="Names with commas, paper, all, or NAME:KEY=VALUE;KEY=VALUE; full is always in."),
    ] = None,
    lights: Annotated[
        str, typer.Option(help="single, multi, both, or auto: what the protocol asks for.")
    ] = "auto",
    environments: Annotated[
        Path | None, typer.Option(help="Folder of maps named like the test lights; else the suite's envmaps.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes at a time.")] = 1,
    device: Annotated[str, typer.Option(help="cpu, cuda, or several with commas for several jobs.")] = "cpu",
    views: shared.Views = 0,
    repeats: shared.Repeats = 4,
    directions: shared.Directions = 64,
    antialias: shared.Antialias = 2,
    max_side: shared.MaxSide = 0,
    shadows: shared.Shadows = "fast",
    lpips_weights: Annotated[list[Path] | None, typer.Option(help="Weights of LPIPS; repeatable.")] = None,
    keep_predictions: Annotated[
        bool, typer.Option(help="Keep the float maps; a large suite fills a disk with them.")
    ] = True,
    settings: shared.Settings = None,
    as_json: Json = False,
) -> None:
    """Train and evaluate scenes x seeds x ablations and print the paper's tables; run again to go on."""
    from lambent_core.startup import prepare

    prepare()
    from lambent_run.benchmark.benchmark import run_benchmark
    from lambent_run.benchmark.plan import parse_variants, plan
    from lambent_run.benchmark.suite import Setting, find_environments, find_scenes
    from lambent_run.report.request import EvaluationRequest, as_shadows

    chosen = {"auto": None, "single": ("single",), "multi": ("multi",), "both": ("single", "multi")}
    if lights not in chosen:
        raise UsageError("benchmark.lights_unknown", f'--lights "{lights}" is none of {", ".join(chosen)}')
    names = tuple(name for item in scenes or () for name in item.split(",") if name)
    maps = find_environments(suite_dir, environments)
    request = EvaluationRequest(
        num_views=views,
        num_repeats=repeats,
        num_directions=directions,
        antialias=antialias,
        max_side=max_side,
        shadows=as_shadows(shadows),
        environments=None if maps is None else maps.resolve(),
        lpips_weights=tuple(path.resolve() for path in lpips_weights or ()),
    )
    cells = plan(
        find_scenes(suite_dir, names),
        parse_variants(ablations or ()),
        parse_seeds(seeds),
        cast("tuple[Setting, ...] | None", chosen[lights]),
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
    if as_json:
        typer.echo(json.dumps({"tables": str(out / "table.json"), "failed": list(outcome.failed)}))
    else:
        typer.echo(outcome.markdown)
        typer.echo(f"tables: {out / 'table.md'}, table.csv, table.json", err=True)
    if outcome.failed:
        raise typer.Exit(1)


def parse_seeds(text: str) -> tuple[int, ...]:
    """Return seeds from `0,1,2`; raises `UsageError` for anything else."""
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not parts or not all(part.isdigit() for part in parts):
        raise UsageError("benchmark.seeds", f'--seeds "{text}" must be whole numbers with commas: 0,1,2')
    return tuple(dict.fromkeys(int(part) for part in parts))
