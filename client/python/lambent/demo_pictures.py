"""The demo's pictures and figures: rendered from the bundle and compared with the truth."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from lambent_core.colour import linear_from_srgb, srgb_from_linear
from lambent_relight import (
    RelitPicture,
    Renderer,
    load_bundle,
    load_environment,
    write_picture_exr,
    write_png,
)
from lambent_relight.batch.plan import renderer_digest

from lambent import truth
from lambent.contact_sheet import write_contact_sheet
from lambent.truth import Picture, TrueView

NUM_SAMPLES = 256
ANTIALIAS = 2
"""Rays per pixel along each side, for pictures and albedo alike."""
NUM_SHOWN = 2
MAPS = (("perceptual_roughness", "roughness", 0.5), ("metalness", "metalness", 0.0))
"""Maps of a rendering, those of the truth, and the value that is their floor: half rough, no metal."""

Note = Callable[[str], None]


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """One line of the table: a score, and that of a trivial answer (the floor; see `format_table`)."""

    name: str
    unit: str
    value: float
    floor: float
    larger_is_better: bool

    def text(self, number: float) -> str:
        """Return `number`, the value or the floor, with its unit: differences of maps need a digit more."""
        return f"{number:.1f} {self.unit}" if self.unit else f"{number:.2f}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """The scene of the demo: where it lies and which lights it was photographed and rendered in."""

    folder: Path
    train_light: str
    unseen_lights: tuple[str, ...]

    @classmethod
    def open(cls, folder: Path) -> "Sample":
        """Return the sample in `folder`, as its scene.json describes it."""
        info = json.loads((folder / "scene.json").read_text())
        train_light = f"{info['train_env']}_{info['rotations'][0]}"
        return cls(folder=folder, train_light=train_light, unseen_lights=tuple(info["test_envs"]))

    def environment(self, light: str) -> Path:
        """Return the file of an unseen light's environment map."""
        return self.folder / "envmaps" / f"{light}.hdr"


@dataclass(frozen=True, kw_only=True)
class Rendered:
    """Renderings of one held-out view; colours over white, sRGB-encoded unless the name says linear."""

    view: TrueView
    reconstruction: RelitPicture
    relit: dict[str, RelitPicture]
    albedo_linear: Picture
    normal: Picture


def make_pictures(bundle: Path, sample: Sample, output: Path, note: Note) -> list[Figure]:
    """Render, write and score; return the figures that were written to `output`/metrics.json."""
    opened = load_bundle(bundle)
    renderer = Renderer(opened)
    lights = (sample.train_light, *sample.unseen_lights)
    folders = sorted(path for path in sample.folder.glob("test_*") if path.is_dir())
    views = [truth.read_view(folder, lights) for folder in folders]
    # Views of different height: the sample's test cameras climb a spiral.
    shown = views[:: max(1, len(views) // NUM_SHOWN)][:NUM_SHOWN]
    albedo = {view.name: _albedo_over_white(renderer, view) for view in views}
    ratio = truth.albedo_ratio([albedo[view.name] for view in views], views)
    trained = opened.trained_environment(opened.manifest.train_lights[0])
    unseen = {light: load_environment(sample.environment(light)) for light in sample.unseen_lights}
    rendered = []
    for view in shown:
        note(f"rendering {view.name}: as photographed")
        reconstruction = renderer.render(view.camera, trained, spp=NUM_SAMPLES, antialias=ANTIALIAS)
        relit = {}
        for light, environment in unseen.items():
            note(f"rendering {view.name}: under {light}")
            relit[light] = renderer.render(
                view.camera,
                environment,
                spp=NUM_SAMPLES,
                antialias=ANTIALIAS,
                albedo_ratio=ratio,
            )
        seen = reconstruction
        rendered.append(
            Rendered(
                view=view,
                reconstruction=reconstruction,
                relit=relit,
                albedo_linear=np.clip(ratio * albedo[view.name], 0.0, 1.0),
                normal=truth.blend_normals(seen.normal.astype(np.float64), seen.coverage.astype(np.float64)),
            )
        )
    figures = _score(sample, views, albedo, ratio, rendered)
    _write_pictures(rendered, output)
    _write_sheet(sample, rendered, figures, output / "contact_sheet.png")
    _write_metrics(opened.manifest, ratio, figures, [view.name for view in shown], output)
    return figures


def format_table(figures: list[Figure]) -> str:
    """Return the figures as a plain table."""
    width = max(len(figure.name) for figure in figures)
    lines = [f"{'':{width}}  {'here':>6}      {'floor':>6}"]
    for figure in figures:
        here, floor = (f"{number:6.2f} {figure.unit:3}" for number in (figure.value, figure.floor))
        lines.append(f"{figure.name:{width}}  {here:>10}  {floor:>10}".rstrip())
    lines.append(
        "floor: the nearest photograph as reconstruction; the photograph itself as albedo and as relit"
    )
    lines.append("picture; the direction to the camera as normal; roughness 0.5 and no metal anywhere.")
    return "\n".join(lines)


def _albedo_over_white(renderer: Renderer, view: TrueView) -> Picture:
    seen = renderer.view(view.camera, ANTIALIAS)
    alpha = seen.coverage().astype(np.float64)
    return seen.mean(seen.hits.albedo) * alpha + 1.0 - alpha


def _shown(picture: RelitPicture) -> Picture:
    """Return a picture as it is compared: sRGB-encoded with straight alpha, then over white."""
    return srgb_from_linear(picture.rgb.astype(np.float64)) * picture.opacity + 1.0 - picture.opacity


def _score(
    sample: Sample,
    views: list[TrueView],
    albedo: dict[str, Picture],
    ratio: Picture,
    rendered: list[Rendered],
) -> list[Figure]:
    light, shown = sample.train_light, [r.view for r in rendered]

    def decibel(name: str, value: float, floor: float) -> Figure:
        return Figure(name=name, unit="dB", value=value, floor=floor, larger_is_better=True)

    def mean_psnr(pictures: list[Picture], light: str) -> float:
        true = [r.view.pictures_srgb[light] for r in rendered]
        return float(np.mean([truth.psnr(p, t) for p, t in zip(pictures, true, strict=True)]))

    photographs = [linear_from_srgb(view.pictures_srgb[light]) for view in views]
    figures = [
        decibel(
            "reconstruction, PSNR",
            mean_psnr([_shown(r.reconstruction) for r in rendered], light),
            mean_psnr([truth.nearest_photograph(sample.folder, r.view, light) for r in rendered], light),
        ),
        decibel(
            "albedo (scaled), PSNR",
            truth.albedo_psnr([albedo[view.name] for view in views], ratio, views),
            truth.albedo_psnr(photographs, truth.albedo_ratio(photographs, views), views),
        ),
    ]
    copied = [r.view.pictures_srgb[light] for r in rendered]
    for unseen in sample.unseen_lights:
        relit = mean_psnr([_shown(r.relit[unseen]) for r in rendered], unseen)
        figures.append(decibel(f"relit under {unseen}, PSNR", relit, mean_psnr(copied, unseen)))
    figures.append(
        Figure(
            name="normals, mean error",
            unit="deg",
            value=float(np.mean([truth.normal_error_deg(r.normal, r.view) for r in rendered])),
            floor=float(np.mean([truth.normal_error_deg(_towards_camera(v), v) for v in shown])),
            larger_is_better=False,
        )
    )
    for name, truth_of, trivial in MAPS:
        pairs = [
            (getattr(r.reconstruction, name)[..., 0], getattr(r.view, truth_of), r.view.mask)
            for r in rendered
        ]
        value = float(
            np.mean([truth.rmse(made.astype(np.float64), true, mask) for made, true, mask in pairs])
        )
        floor = float(
            np.mean([truth.rmse(np.full_like(true, trivial), true, mask) for _, true, mask in pairs])
        )
        figures.append(
            Figure(name=f"{truth_of}, rmse", unit="", value=value, floor=floor, larger_is_better=False)
        )
    return figures


def _towards_camera(view: TrueView) -> Picture:
    _, direction = view.camera.rays()
    return -direction.reshape(view.camera.height, view.camera.width, 3).astype(np.float64)


def _write_pictures(rendered: list[Rendered], output: Path) -> None:
    for item in rendered:
        folder = output / item.view.name
        pictures = {"reconstruction": item.reconstruction}
        pictures |= {f"relit_{light}": picture for light, picture in item.relit.items()}
        for name, picture in pictures.items():
            write_png(folder / f"{name}.png", picture)
            write_picture_exr(folder / f"{name}.exr", picture)


def _write_sheet(sample: Sample, rendered: list[Rendered], figures: list[Figure], path: Path) -> None:
    columns = ["photograph", "reconstruction", "albedo", "true albedo", "normals", "true normals"]
    for _, name, _ in MAPS:
        columns += [name, f"true {name}"]
    for light in sample.unseen_lights:
        columns += [f"relit: {light}", f"truth: {light}"]
    rows = []
    for item in rendered:
        mask = item.view.mask[..., None]
        tiles = [
            item.view.pictures_srgb[sample.train_light],
            _shown(item.reconstruction),
            srgb_from_linear(np.where(mask, item.albedo_linear, 1.0)),
            srgb_from_linear(item.view.albedo),
            np.where(mask, 0.5 + 0.5 * item.normal, 1.0),
            np.where(mask, 0.5 + 0.5 * item.view.normal, 1.0),
        ]
        for name, truth_of, _ in MAPS:
            maps = (getattr(item.reconstruction, name)[..., 0], getattr(item.view, truth_of))
            tiles += [np.where(mask, map_[..., None], 1.0).repeat(3, axis=-1) for map_ in maps]
        for light in sample.unseen_lights:
            tiles += [_shown(item.relit[light]), item.view.pictures_srgb[light]]
        rows.append((item.view.name, tiles))
    note = "   ".join(f"{f.name} {f.text(f.value)} (floor {f.text(f.floor)})" for f in figures)
    title = "Lambent demo: held-out views of the bundled sample, and two lights it was never photographed in"
    write_contact_sheet(path, columns, rows, title=title, note=note)


def _write_metrics(
    manifest: Any, ratio: Picture, figures: list[Figure], shown: list[str], output: Path
) -> None:
    report = {
        "bundle_files_sha256": sorted(entry.sha256 for entry in manifest.files),
        "renderer": renderer_digest(),
        "views": shown,
        "num_samples": NUM_SAMPLES,
        "antialias": ANTIALIAS,
        "albedo_ratio_rgb": ratio.tolist(),
        "figures": [asdict(figure) for figure in figures],
    }
    (output / "metrics.json").write_text(json.dumps(report, indent=1) + "\n")
    (output / "metrics.txt").write_text(format_table(figures) + "\n")


def read_figures(bundle: Path, output: Path) -> list[Figure] | None:
    """Return an earlier run's figures if its pictures show this bundle and are made like ours, else None."""
    report_path = output / "metrics.json"
    if not (report_path.is_file() and (output / "contact_sheet.png").is_file()):
        return None
    report = json.loads(report_path.read_text())
    manifest = json.loads((bundle / "manifest.json").read_text())
    if report.get("bundle_files_sha256") != sorted(entry["sha256"] for entry in manifest["files"]):
        return None
    made = {"num_samples": NUM_SAMPLES, "antialias": ANTIALIAS, "renderer": renderer_digest()}
    if any(report.get(name) != value for name, value in made.items()):
        return None
    return [Figure(**figure) for figure in report["figures"]]
