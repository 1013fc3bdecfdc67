"""probe: what an environment map holds, as pictures of balls and as numbers."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from lambent_core.colour import srgb_from_linear
from lambent_core.pictures import EnvironmentInput
from lambent_relight import Environment, write_environment
from lambent_relight.environment.input import OpenedEnvironment, open_environment
from PIL import Image

from lambent.cli.output import FilesOption, JsonOption, Output, RotateOption
from lambent.cli.rendering import relight_errors
from lambent.cli.setting_options import takes

_NUM_LIGHTS = 4


@takes("given", EnvironmentInput)
def probe(
    env: Annotated[Path, typer.Argument(metavar="MAP", help="Environment map, .exr or .hdr.")],
    output_folder: FilesOption,
    rotate_deg: RotateOption = 0.0,
    exposure_ev: Annotated[float, typer.Option(help="Brighten the PNGs by this many stops.")] = 0.0,
    from_deg: Annotated[float, typer.Option(help="Azimuth of the eye; 0 looks at the balls from +x.")] = 0.0,
    size: Annotated[int, typer.Option(help="Width of the balls, pixels.", min=2, max=4096)] = 256,
    as_json: JsonOption = False,
    *,
    given: EnvironmentInput,
) -> None:
    """Write chrome_ball.png, grey_ball.png, map.png, environment.exr (our axes) and probe.json into DIR."""
    output = Output(as_json)
    with relight_errors():
        # Compiled code takes a moment to import, which the help text should not pay.
        from lambent_relight.environment.probes import chrome_ball, grey_ball, upright_map

        opened = open_environment(env, given)
        for note in opened.notes(env.name):
            output.note(note)
        light = opened.environment.rotated(rotate_deg)
        output_folder.mkdir(parents=True, exist_ok=True)
        gain = np.float32(2.0**exposure_ev)
        for name, ball in (("chrome_ball", chrome_ball), ("grey_ball", grey_ball)):
            seen = ball(light, size, from_deg=from_deg)
            encoded = np.concatenate([srgb_from_linear(gain * seen.rgb), seen.opacity], axis=-1)
            _write(output_folder / f"{name}.png", encoded)
        upright = upright_map(light, max(size, 2))
        _write(output_folder / "map.png", srgb_from_linear(gain * upright))
        straight = light.radiance if not light.rotate_deg else upright_map(light, light.radiance.shape[0])
        write_environment(output_folder / "environment.exr", straight, half=False)
        report = describe(opened, light, env.name)
    (output_folder / "probe.json").write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    lines = [f"{output_folder}  (mean {report['mean_radiance']:.4g}, brightest {report['brightest']:.4g})"]
    lines += [
        f"light {number}: azimuth {one['azimuth_deg']:.1f}, elevation {one['elevation_deg']:.1f} degrees, "
        f"{100.0 * one['share']:.1f} % of the energy"
        for number, one in enumerate(report["dominant_lights"], 1)
    ]
    output.result("\n".join(lines), {"path": str(output_folder), **report})


def describe(opened: OpenedEnvironment, light: Environment, name: str) -> dict[str, Any]:
    """Return the figures of a map: size, energy, brightest value, dominant lights, what was changed."""
    from lambent_relight.environment.dominant_lights import energy, split

    total = energy(light.radiance)
    parts = split(light, _NUM_LIGHTS)
    lights = [
        {
            "azimuth_deg": float(np.degrees(np.arctan2(y, x))),
            "elevation_deg": float(np.degrees(np.arcsin(np.clip(z, -1.0, 1.0)))),
            "radiance_solid_angle": [float(value) for value in flux],
            "share": float(flux.sum() / total.sum()),
        }
        for (x, y, z), flux in zip(parts.directions, parts.radiance_solid_angle, strict=True)
    ]
    clamp = {**asdict(opened.clamp), "share_lost": opened.clamp.share_lost} if opened.clamp else None
    return {
        "map": name,
        "height": light.radiance.shape[0],
        "width": light.radiance.shape[1],
        "mean_radiance": float(total.mean() / (4.0 * np.pi)),
        "brightest": float(light.radiance.max()),
        "energy": [float(value) for value in total],
        "dominant_lights": lights,
        "mended": asdict(light.cleaning),
        "reduced_from": light.reduced_from,
        "sun_clamp": clamp,
    }


def _write(path: Path, encoded: np.ndarray) -> None:
    Image.fromarray(np.round(255.0 * np.clip(encoded, 0.0, 1.0)).astype(np.uint8)).save(path)
