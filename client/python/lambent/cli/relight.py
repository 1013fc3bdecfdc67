"""relight: a bundle under other environments."""

from pathlib import Path
from typing import Annotated, cast

import typer
from lambent_relight import MaterialEdit, load_cameras
from lambent_relight.environment.axes import OURS
from lambent_relight.refined.sampling_plan import BOUNCES, Bounces
from lambent_relight.tone_mapping import NAMES as TONE_MAPPINGS

from lambent.cli.environment_options import (
    EnvAxesOption,
    MendEnvOption,
    SunClampOption,
    environment_input,
)
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
from lambent.errors import UsageProblemError

QUALITIES = ("preview", "baked", "refined")


def relight(
    bundle: Annotated[Path, typer.Argument(metavar="BUNDLE", help="Bundle folder or zip.")],
    env: Annotated[
        list[Path], typer.Option("--env", metavar="MAP", help="Environment map, .exr or .hdr; repeatable.")
    ],
    output_folder: Annotated[Path, typer.Option("-o", "--output", metavar="DIR", help="Where pictures go.")],
    cameras: Annotated[
        Path | None, typer.Option(metavar="FILE", help="cameras.json as in the bundle.")
    ] = None,
    turntable: Annotated[
        int, typer.Option(metavar="N", help="N cameras around the object instead of a file.", min=0)
    ] = 0,
    rotate_deg: Annotated[float, typer.Option(help="Turn the light by this angle about +z, degrees.")] = 0.0,
    exposure_ev: Annotated[
        float, typer.Option(help="Brighten the PNG by this many stops; the EXR stays as it is.")
    ] = 0.0,
    tone_mapping: Annotated[str, typer.Option(help=f"Of the PNG: {', '.join(TONE_MAPPINGS)}.")] = "linear",
    quality: Annotated[
        str, typer.Option(help="preview, baked (both without noise, at once) or refined.")
    ] = "refined",
    spp: Annotated[int, typer.Option(help="Light directions per pixel.", min=2, max=65536)] = 64,
    until_stderr: Annotated[
        float, typer.Option(help="Go on until the standard error is this share of the radiance; 0: do not.")
    ] = 0.0,
    albedo_gain: Annotated[
        tuple[float, float, float], typer.Option(metavar="R G B", help="Factors on the albedo.")
    ] = (1.0, 1.0, 1.0),
    albedo: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="R G B", help="Linear albedo instead of the object's own."),
    ] = None,
    roughness_scale: Annotated[float, typer.Option(help="Factor on perceptual roughness.")] = 1.0,
    object_rotate_deg: Annotated[
        float, typer.Option(help="Turn the object, not its light, by this angle about +z, degrees.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of every random number.", min=0)] = 0,
    background: Annotated[str, typer.Option(help="transparent, environment or white.")] = "transparent",
    indirect: Annotated[
        bool, typer.Option("--indirect/--direct-only", help="Light that bounced once, or not.")
    ] = True,
    bounces: Annotated[
        str,
        typer.Option(
            help="Of refined pictures: auto (a cache adapted to the light, else baked transport), adapted, "
            "transport, or one."
        ),
    ] = "auto",
    antialias: Annotated[
        int, typer.Option(help="Rays per pixel along each side, at the object.", min=1, max=8)
    ] = 2,
    size: Annotated[int, typer.Option(help="Side of turntable pictures, pixels; 0: as photographed.")] = 0,
    env_axes: EnvAxesOption = OURS,
    sun_clamp: SunClampOption = 0.0,
    mend_env: MendEnvOption = False,
    as_json: JsonOption = False,
) -> None:
    """Render a bundle under other environments: DIR/<map>/<camera>.png (sRGB) and .exr (linear).

    Run again, it makes only what is missing or has changed; DIR/pictures.json lists everything.
    """
    check_choice("--quality", quality, QUALITIES)
    check_choice("--tone-mapping", tone_mapping, TONE_MAPPINGS)
    check_choice("--bounces", bounces, BOUNCES)
    if (cameras is None) == (turntable == 0):
        raise UsageProblemError(
            "cli.cameras", "one of --cameras and --turntable is needed", "for a first look: --turntable 8"
        )
    light = environment_input(env_axes, sun_clamp, mend_env)
    names = [path.stem for path in env]
    if len(set(names)) != len(names):
        raise UsageProblemError("cli.same_names", f"two maps are called the same: {names}", "rename one")
    with relight_errors():
        renderer = open_renderer(bundle)
        views = (
            load_cameras(cameras) if cameras is not None else around_object(renderer, turntable, size=size)
        )
        shots = [
            Shot(name=f"{path.stem}/{view.name}", camera=view, environment=path, rotate_deg=rotate_deg)
            for path in env
            for view in views
        ]
        look = Look(
            quality=quality,
            num_samples=spp,
            seed=seed,
            exposure_ev=exposure_ev,
            tone_mapping=tone_mapping,
            background=background,
            indirect=indirect,
            antialias=antialias,
            until_stderr=until_stderr,
            edit=MaterialEdit(albedo_gain=albedo_gain, albedo=albedo, roughness_scale=roughness_scale),
            object_rotate_deg=object_rotate_deg,
            light=light,
            bounces=cast(Bounces, bounces),
        )
        render_shots(renderer, shots, look, output_folder, Output(as_json))
