"""view: look at a bundle in a window of this machine, or in a browser."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from lambent_core.pictures import EnvironmentInput
from lambent_relight import Renderer
from lambent_relight.tone_mapping import NAMES as TONE_MAPPINGS

from lambent.cli.output import BundleArgument, JsonOption, MapsOption, Output
from lambent.cli.rendering import check_choice, open_bundle, relight_errors
from lambent.cli.setting_options import takes
from lambent.desktop.channels import RADIANCE, SURFACE
from lambent.desktop.state import BACKDROPS
from lambent.desktop.viewer import DesktopOptions, show

_DESKTOP = "With --desktop"
_option = partial(typer.Option, rich_help_panel=_DESKTOP)


@takes("light", EnvironmentInput)
def view(
    context: typer.Context,
    bundle: BundleArgument,
    env: Annotated[list[Path] | None, MapsOption] = None,
    desktop: Annotated[bool, typer.Option("--desktop", help="In a window of this machine.")] = False,
    screenshot: Annotated[
        Path | None, _option(metavar="OUT.png", help="Write the window's picture and end.")
    ] = None,
    overlays: Annotated[bool, _option(help="Text and sliders in the screenshot.")] = False,
    size: Annotated[tuple[int, int], _option(metavar="W H", help="Pixels.")] = (960, 720),
    turn_deg: Annotated[float, _option(help="Camera further around the object, degrees.")] = 0.0,
    rotate_deg: Annotated[float, _option(help="Turn the light about +z, degrees.")] = 0.0,
    object_rotate_deg: Annotated[float, _option(help="Turn the object about +z, degrees.")] = 0.0,
    exposure_ev: Annotated[float, _option(help="Stops.")] = 0.0,
    tone_mapping: Annotated[str, _option(help=f"{', '.join(TONE_MAPPINGS)}.")] = "linear",
    channel: Annotated[str, _option(help=f"{', '.join((*RADIANCE, *SURFACE))} and more.")] = "final",
    background: Annotated[str, _option(help=f"{', '.join(BACKDROPS)}.")] = "grey",
    photographs: Annotated[
        Path | None, _option(metavar="DIR", help="The scene's photographs, to compare.")
    ] = None,
    photograph: Annotated[str, _option(metavar="NAME", help="Begin beside this photograph.")] = "",
    compare: Annotated[bool, _option("--compare", help="Begin with two maps side by side.")] = False,
    split: Annotated[float, _option(help="Border of a comparison, 0 to 1.", min=0.0, max=1.0)] = 0.5,
    save_to: Annotated[Path, _option(metavar="DIR", help="Where the key s saves.")] = Path(),
    as_json: JsonOption = False,
    *,
    light: EnvironmentInput,
) -> None:
    """Look at a bundle from all sides and in any light."""
    output = Output(as_json)
    if not desktop:
        _show_in_browser(context, bundle, list(env or ()), light, output)
        return
    check_choice("--tone-mapping", tone_mapping, TONE_MAPPINGS)
    check_choice("--background", background, tuple(BACKDROPS))
    options = DesktopOptions(
        environments=tuple(env or ()),
        light=light,
        photographs=photographs,
        photograph=photograph,
        compare=compare,
        split=split,
        size=size,
        turn_deg=turn_deg,
        rotate_deg=rotate_deg,
        object_rotate_deg=object_rotate_deg,
        exposure_ev=exposure_ev,
        tone_mapping=tone_mapping,
        channel=channel,
        backdrop=background,
        save_to=save_to,
        screenshot=screenshot,
        overlays=overlays,
    )
    with relight_errors():
        files = show(Renderer(open_bundle(bundle)), options)
    for file in files:
        output.result(str(file), {"path": str(file)})


def _show_in_browser(
    context: typer.Context, bundle: Path, environments: list[Path], light: EnvironmentInput, output: Output
) -> None:
    from lambent.cli.web_view import view_in_browser

    for parameter in context.command.params:
        source = context.get_parameter_source(parameter.name or "")
        given = source is not None and source.name == "COMMANDLINE"
        if given and getattr(parameter, "rich_help_panel", None) == _DESKTOP:
            output.note(f"{parameter.opts[0]} has no effect without --desktop")
    view_in_browser(bundle, environments, light, output)
