"""Compare pictures of our web viewer and of `<model-viewer>` with path-traced truth, under unseen lights.

    python -m benchmarks side_by_side --scene CAPTURE --bundle BUNDLE --environments FOLDER
        [--views 4] [--lights NAME ...] [--strip FILE.jpg] [--only ours]

Both draw the same mesh file (ours with the bundle's transport) from the cameras of the test views, in the
truth's size, under the same map, without background and ground, exposure 1, tone curve *neutral*. CAPTURE has
TensoIR-synthetic's layout; truth is radiance_<light>.exr of a test view, or rgba_<light>.png, of which
clipped pixels are left out. A light `name_090` is the map `name` turned by 90 degrees. Figures are PSNR in dB
of sRGB-encoded values over black: where truth covers more than half of a pixel, over the whole picture, and
where it is covered after one factor per channel and picture. Then `<model-viewer>` draws a mirror ball under
turned maps, against what a mirror has to show: PSNR has to be best at no turn.
"""

import argparse
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lambent.truth import psnr, read_camera
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from lambent_core.exr import read_exr_parts
from lambent_relight import load_environment
from lambent_relight.cameras import Camera
from lambent_relight.tone_mapping import tone_mapped
from numpy.typing import NDArray
from PIL import Image

from benchmarks.browser_pictures import BALL, ModelViewer, Picture, rgbe_bytes, versions, viewers
from benchmarks.mirror_ball import reflected

QUICK = "--scene {sample} --bundle {bundle} --environments {maps} --views 1 --lights sunset --only ours"
SWEEP_DEG = (-90, -45, -11.25, -5.625, 0, 5.625, 11.25, 45, 90, 180)
LEAST_OVERLAP = 0.97
_FACTORS = np.arange(0.3, 3.0, 0.01)
_CELL = 256


@dataclass(frozen=True, kw_only=True)
class Truth:
    """A test view under one light."""

    encoded: Picture
    """[H, W, 3], through the tone curve, sRGB-encoded, over black."""
    coverage: NDArray[np.float64]
    """[H, W]."""
    known: NDArray[np.bool_]
    """[H, W], where it is not clipped."""

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Return where the object covers more than half of a known pixel."""
        return (self.coverage > 0.5) & self.known


def read_truth(folder: Path, light: str) -> Truth:
    """Return the truth of a view folder under a light, through the tone curve *neutral*."""
    linear = folder / f"radiance_{light}.exr"
    if linear.is_file():
        channels = read_exr_parts(linear, max_pixels=1 << 24)[0].channels
        radiance = np.stack([channels[name].pixels.astype(np.float64) for name in "RGB"], axis=-1)
        coverage = channels["A"].pixels.astype(np.float64)
        known = np.ones(coverage.shape, bool)
    else:
        with Image.open(folder / f"rgba_{light}.png") as image:
            pixels = np.asarray(image.convert("RGBA"), np.float64) / 255.0
        radiance, coverage = linear_from_srgb(pixels[..., :3]), pixels[..., 3]
        known = (pixels[..., :3] < 1.0).all(axis=-1) | (coverage == 0.0)
    encoded = srgb_from_linear(tone_mapped(radiance, "neutral").astype(np.float64))
    return Truth(encoded=encoded * coverage[..., None], coverage=coverage, known=known)


def overlap(found: Picture, truth: Truth) -> float:
    """Return the intersection over the union of both silhouettes."""
    drawn, true = found[..., 3] > 0.5, truth.coverage > 0.5
    return float((drawn & true).sum() / max((drawn | true).sum(), 1))


def scores(found: Picture, truth: Truth) -> dict[str, float]:
    """Return `object`, `picture` and `scaled`, PSNR in dB, and `overlap` of a picture with straight alpha.

    `scaled` is that of the object after the best factor per channel on linear display values, to 1 %.
    """
    over_black = found[..., :3] * found[..., 3:]
    is_object = truth.inside
    drawn, true = over_black[is_object], truth.encoded[is_object]
    linear = linear_from_srgb(drawn)
    errors = [((srgb_from_linear(linear * factor) - true) ** 2).mean(axis=0) for factor in _FACTORS]
    return {
        "object": psnr(drawn, true),
        "picture": psnr(over_black[truth.known], truth.encoded[truth.known]),
        "scaled": psnr(srgb_from_linear(linear * _FACTORS[np.argmin(errors, axis=0)]), true),
        "overlap": overlap(found, truth),
    }


def turned(radiance: NDArray[np.floating], degrees: float) -> NDArray[np.floating]:
    """Return a map [height, width, 3] turned about the vertical axis by `degrees`, to whole columns.

    What shone from direction d shines from d turned by +degrees: azimuth decreases to the right.
    """
    return np.roll(radiance, -round(degrees / 360.0 * radiance.shape[1]), axis=1)


def lights_of(view: Path) -> list[str]:
    """Return the lights of a test view: those with radiance, or else all."""
    kinds = ("radiance_*.exr", "rgba_*.png")
    found = next(names for kind in kinds if (names := sorted(view.glob(kind))))
    return [path.stem.partition("_")[2] for path in found]


def write_maps(environments: Path, lights: Sequence[str], folder: Path) -> None:
    """Write the map of every light, turned as its name says, as `folder`/<light>.hdr."""
    folder.mkdir(parents=True, exist_ok=True)
    for light in lights:
        name, degrees = light, 0
        match = re.fullmatch(r"(.+)_(\d{3})", light)
        if match and not (environments / f"{light}.hdr").is_file():
            name, degrees = match[1], int(match[2])
        radiance = load_environment(environments / f"{name}.hdr").radiance
        (folder / f"{light}.hdr").write_bytes(rgbe_bytes(turned(radiance, degrees)))


def sweep(side: ModelViewer, camera: Camera, light: str, maps: Path) -> dict[float, float]:
    """Return the PSNR of the mirror ball under the light by degrees that the map was turned by."""
    environment = load_environment(maps / f"{light}.hdr")
    shown, where = reflected(camera, environment)
    found = {}
    for degrees in SWEEP_DEG:
        name = f"{light}_turned_{degrees}.hdr"
        (maps / name).write_bytes(rgbe_bytes(turned(environment.radiance, degrees)))
        side.light(name)
        found[degrees] = psnr(side.picture(camera)[where][:, :3], shown[where])
    return found


def table(records: Sequence[dict[str, Any]], sides: Sequence[str]) -> str:
    """Return means by light, and over all, as a table: object / whole picture / object after factors."""
    lines = ["| light | " + " | ".join(sides) + " |", "| --- |" + " --- |" * len(sides)]
    lights = list(dict.fromkeys(record["light"] for record in records))
    for light in (*lights, None):
        cells = []
        for side in sides:
            chosen = [r[side] for r in records if light in (None, r["light"])]
            means = [np.mean([scored[kind] for scored in chosen]) for kind in ("object", "picture", "scaled")]
            cells.append(" / ".join(f"{mean:.2f}" for mean in means))
        lines.append(f"| {light or 'mean'} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def strip(
    pictures: Path,
    lights: Sequence[str],
    view: str,
    sides: Sequence[str],
    path: Path,
    most_bytes: int = 150_000,
) -> None:
    """Write truth and all sides of one view, a row per light, as one JPEG of at most `most_bytes`.

    The kept pictures are cut to the square around everything that they show.
    """
    rows = [
        [Image.open(pictures / f"{light}_{view}_{side}.png") for side in ("truth", *sides)]
        for light in lights
    ]
    # A picture may be black.
    boxes = np.array([box for row in rows for cell in row if (box := cell.getbbox()) is not None])
    low, high = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    middle, half = (low + high) / 2.0, (high - low).max() / 2.0 + 2.0
    box = (*(middle - half), *(middle + half))
    cells = [
        [
            np.asarray(cell.resize((_CELL, _CELL), Image.Resampling.BICUBIC, box=_inside(box, cell.size)))
            for cell in row
        ]
        for row in rows
    ]
    picture = Image.fromarray(np.concatenate([np.concatenate(row, axis=1) for row in cells], axis=0))
    path.parent.mkdir(parents=True, exist_ok=True)
    for quality in range(90, 20, -10):
        picture.save(path, quality=quality, optimize=True)
        if path.stat().st_size <= most_bytes:
            return
    raise SystemExit(f"{path} stays above {most_bytes} bytes")


def _inside(box: Sequence[float], size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return a square box, moved, and reduced if need be, into a picture of some size."""
    left, top, right, _ = box
    side = min(right - left, *size)
    left, top = (min(max(low, 0.0), whole - side) for low, whole in zip((left, top), size, strict=True))
    return left, top, left + side, top + side


def keep(path: Path, found: Picture) -> None:
    """Write a picture over black as PNG."""
    over_black = found[..., :3] * (found[..., 3:] if found.shape[-1] == 4 else 1.0)
    Image.fromarray(np.round(255.0 * over_black).astype(np.uint8)).save(path)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("--scene", type=Path, required=True, help="a capture with truth of test views")
    parser.add_argument("--bundle", type=Path, required=True, help="its trained bundle, a folder")
    parser.add_argument("--environments", type=Path, required=True, help="folder of <light>.hdr")
    parser.add_argument("--views", type=int, default=4, help="how many test views, evenly chosen")
    parser.add_argument("--lights", nargs="+", help="default: all that have truth")
    parser.add_argument("--only", choices=("ours",), help="leave <model-viewer> out")
    parser.add_argument("--strip", type=Path, help="write truth and all sides of one view, a row per light")
    parser.add_argument("--strip-view", type=int, default=0, help="which of the views")


def main(options: argparse.Namespace) -> dict[str, Any]:
    """Draw every view under every light with every side, and print the table."""
    folders = sorted(path for path in options.scene.glob("test_*") if path.is_dir())
    chosen = np.unique(np.linspace(0, len(folders) - 1, options.views).round().astype(int))
    views = [(folders[index], read_camera(folders[index])) for index in chosen]
    lights = options.lights or lights_of(folders[0])
    maps, pictures = options.out / "maps", options.out / "pictures"
    write_maps(options.environments, lights, maps)
    pictures.mkdir(exist_ok=True)
    theirs = options.only != "ours"
    sides = ["ours baked", "ours refined", *(["model-viewer"] if theirs else [])]
    size = (views[0][1].width, views[0][1].height)
    records, sweeps = [], {}
    print(f"{versions()}; views {', '.join(folder.name for folder, _ in views)}\n", flush=True)
    with viewers(options.bundle, maps, options.out, size, theirs=theirs) as (ours, other):
        for light in lights:
            ours.light(f"{light}.hdr")
            if other:
                other.light(f"{light}.hdr")
            for folder, camera in views:
                truth = read_truth(folder, light)
                drawn = {"ours baked": ours.picture(camera)}
                drawn["ours refined"] = ours.picture(camera, refined=True)
                if other:
                    drawn["model-viewer"] = other.picture(camera)
                found = {side: scores(picture, truth) for side, picture in drawn.items()}
                records.append({"light": light, "view": folder.name, **found})
                keep(pictures / f"{light}_{folder.name}_truth.png", truth.encoded)
                for side, picture in drawn.items():
                    keep(pictures / f"{light}_{folder.name}_{side}.png", picture)
                told = ", ".join(f"{side} {found[side]['object']:.2f}" for side in sides)
                print(f"{light} {folder.name}: {told}", flush=True)
        if other:
            other.open(BALL)
            sweeps = {light: sweep(other, views[0][1], light, maps) for light in lights}
    print(f"\nPSNR: object / whole picture / object after factors\n\n{table(records, sides)}\n")
    overlaps = {side: min(record[side]["overlap"] for record in records) for side in sides}
    print("smallest overlap of silhouettes: " + ", ".join(f"{k} {v:.3f}" for k, v in overlaps.items()))
    for light, found in sweeps.items():
        told = ", ".join(f"{degrees:g}: {value:.2f}" for degrees, value in found.items())
        print(f"mirror ball in model-viewer, {light} turned by degrees: {told}")
    if options.strip:
        strip(pictures, lights, views[options.strip_view][0].name, sides, options.strip)
    worst = min(overlaps.values())
    if worst < LEAST_OVERLAP:
        raise SystemExit(f"the silhouettes do not agree: {worst:.3f}")
    for light, found in sweeps.items():
        if max(found, key=found.__getitem__) != 0:
            raise SystemExit(f"{light}: the mirror shows a turned map")
    return {"records": records, "overlaps": overlaps, "sweeps": sweeps, "versions": versions()}
