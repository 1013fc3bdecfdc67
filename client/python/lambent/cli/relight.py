"""relight: a bundle under other environments."""

from pathlib import Path
from typing import Annotated

import typer
from lambent_core.pictures import EnvironmentInput, RenderMaterial, RenderSettings
from lambent_relight import load_cameras
from lambent_relight.batch.manifest import Files
from lambent_relight.object_cameras import around_object

from lambent.cli.output import (
    BundleArgument,
    JsonOption,
    MapsOption,
    Output,
    PicturesOption,
    RotateOption,
)
from lambent.cli.rendering import (
    Shot,
    asset_here,
    light_here,
    make_pictures,
    open_bundle,
    relight_errors,
    rows_of,
)
from lambent.cli.setting_options import from_options, takes
from lambent.errors import UsageProblemError


@takes("settings", RenderSettings)
@takes("given", EnvironmentInput)
def relight(
    bundle: BundleArgument,
    env: Annotated[list[Path], MapsOption],
    output_folder: PicturesOption,
    cameras: Annotated[
        Path | None, typer.Option(metavar="FILE", help="cameras.json as in the bundle.")
    ] = None,
    turntable: Annotated[
        int, typer.Option(metavar="N", help="N cameras around the object instead of a file.", min=0)
    ] = 0,
    rotate_deg: RotateOption = 0.0,
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
    size: Annotated[int, typer.Option(help="Side of turntable pictures, pixels; 0: as photographed.")] = 0,
    half: Annotated[
        bool,
        typer.Option("--half/--float", help="Half or 32-bit floats in the EXR; depth and mask have 32 bits."),
    ] = True,
    as_json: JsonOption = False,
    *,
    settings: RenderSettings,
    given: EnvironmentInput,
) -> None:
    """Render a bundle under other environments: DIR/<map>/<camera>.png (sRGB) and .exr (linear).

    Run again, it makes only what is missing or has changed; DIR/pictures.json lists everything.
    """
    if (cameras is None) == (turntable == 0):
        raise UsageProblemError(
            "cli.cameras", "one of --cameras and --turntable is needed", "for a first look: --turntable 8"
        )
    material = from_options(
        RenderMaterial,
        albedo_gain=list(albedo_gain),
        albedo=None if albedo is None else list(albedo),
        roughness_scale=roughness_scale,
    )
    names = [path.stem for path in env]
    if len(set(names)) != len(names):
        raise UsageProblemError("cli.same_names", f"two maps are called the same: {names}", "rename one")
    with relight_errors():
        opened = open_bundle(bundle)
        views = load_cameras(cameras) if cameras is not None else around_object(opened, turntable, size=size)
        asset = asset_here(bundle, material=material, object_rotate_deg=object_rotate_deg)
        lights = {path.stem: light_here(path, given, rotate_deg) for path in env}
        shots = [
            Shot(path=f"{name}/{view.name}", light=light, camera=view)
            for name, light in lights.items()
            for view in views
        ]
        rows = rows_of(shots, opened, asset, settings)
        make_pictures(rows, Files.model_construct(linear=True, half=half), output_folder, Output(as_json))
