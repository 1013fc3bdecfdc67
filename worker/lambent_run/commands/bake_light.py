"""The command that adapts a fast cache to an environment."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from lambent_run.commands.shared import Device, Json, Seed, reporting_errors, stopping_on_signals


@reporting_errors
def bake_light(
    source: Annotated[
        Path, typer.Argument(metavar="RUN_OR_BUNDLE", help="Folder made by lambent train, or a bundle.")
    ],
    environment: Annotated[Path, typer.Argument(help="Environment map, .hdr or .exr.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Bundle folder; must not exist yet.")],
    name: Annotated[str, typer.Option(help="The light's name in the bundle; by default the map's.")] = "",
    rotate_deg: Annotated[float, typer.Option(help="Turn the light by this angle about +z, degrees.")] = 0.0,
    albedo_ratio: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="R G B", help="Factors on the stored albedo, by default the bundle's own."),
    ] = None,
    steps: Annotated[int, typer.Option(min=0, help="Training steps; 0 for the usual number.")] = 0,
    seed: Seed = 0,
    device: Device = "",
    as_json: Json = False,
) -> None:
    """Adapt the fast cache to an environment, all bounces included, for `relight --quality refined`."""
    from lambent_core.startup import prepare

    prepare()
    from flashcache.training.light_bake import LightBakeConfig

    from lambent_run.console_reporter import ConsoleReporter
    from lambent_run.run.light_bake import BakeRequest, bake_light

    config = LightBakeConfig()
    request = BakeRequest(
        environment=environment,
        name=name,
        rotate_deg=rotate_deg,
        albedo_ratio=albedo_ratio,
        config=replace(config, num_steps=steps) if steps else config,
        seed=seed,
        device=device,
    )
    with ConsoleReporter(as_json=as_json) as reporter, stopping_on_signals(reporter.request_stop):
        light = bake_light(source, out, request, reporter)
    if not as_json:
        typer.echo(f"bundle: {out} (with fast_cache_{light.name})")
