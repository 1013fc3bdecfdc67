"""Say what a trained model lacks under new light: its shape, with the truth where the camera looks at it.

    python benchmarks/oracle_points.py RUN_DIR SCENE --environments SUITE/envmaps/high_res -o OUT

Test views of the trained run in RUN_DIR are relit as `lambent evaluate` does it, with and without one bounce;
then once more with the true normals, with the true materials, and with both, at the points that camera rays
meet. Where those points lie, what hides the light from them, and what secondary rays hit stay the model's.
So what the last row gains is what better materials and normals could gain, and what it still lacks is where
surfaces are. Figures are those of `tests/references/evaluate.py`.
"""

import argparse
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

os.environ["OMP_WAIT_POLICY"] = "PASSIVE"

import numpy as np
import torch
from flashcache.data.scene import Scene, View
from flashcache.evaluation.metrics import median_albedo_ratio
from flashcache.evaluation.monte_carlo import Picture, monte_carlo
from flashcache.evaluation.relighting import MapLight, relit_radiance
from flashcache.evaluation.supersampling import finer, mean_picture, points_per_ray
from flashcache.evaluation.surface_points import project
from flashcache.evaluation.views import render_surface
from flashcache.physical.brdf import Materials
from flashcache.physical.model import InverseModel
from flashcache.physical.shading import ShadingPoints
from jaxtyping import Float, Float32, Int
from lambent_worker.console_reporter import ConsoleReporter
from lambent_worker.report.predictions import encoded, save_array
from lambent_worker.report.request import evenly_spaced
from lambent_worker.run.evaluation import read_maps
from lambent_worker.run.prepare import open_task
from lambent_worker.run.tasks.training import load_trained, read_scene
from lambent_worker.scenes.detect import describe_scene
from lambent_worker.scenes.lights import select_lights
from lambent_worker.scenes.load import load_scene
from lambent_worker.startup import prepare
from numpy import ndarray
from reference_scores import reference_scores
from torch import Tensor

SMOOTHEST = 0.01
"""Perceptual roughness below which a true surface is shaded as this rough."""


@dataclass(frozen=True, slots=True)
class Replaced:
    """What is true where the camera looks; all else is the model's."""

    normals: bool = False
    materials: bool = False


ROWS = {
    "as trained": Replaced(),
    "true normals": Replaced(normals=True),
    "true materials": Replaced(materials=True),
    "true normals and materials": Replaced(normals=True, materials=True),
}


def pixels_of(view: View, positions: Float[Tensor, "points 3"]) -> Int[Tensor, " points"]:
    """Return the pixel of `view`, counted row by row, in which each point in front of its camera appears."""
    camera = view.camera
    seen = project(camera, positions)
    column = seen.column.long().clamp(0, camera.width - 1)
    row = seen.row.long().clamp(0, camera.height - 1)
    return row * camera.width + column


def with_truth(
    model: InverseModel,
    points: ShadingPoints,
    view: View,
    replaced: Replaced,
    ratio: Float[Tensor, "3"],
) -> tuple[ShadingPoints, Materials]:
    """Return points and materials with what is `replaced`; where the truth covers nothing they stay.

    The true albedo is divided by `ratio`, with which relit pictures multiply it.
    """
    pixel = pixels_of(view, points.positions)
    truth = {name: torch.tensor(values).flatten(0, 1)[pixel] for name, values in view.truth.items()}
    covered = truth["albedo"][:, 3:] > 0.5
    if replaced.normals:
        normal = torch.nn.functional.normalize(truth["normal"][:, :3], dim=-1)
        points = points._replace(normal=torch.where(covered, normal, points.normal))
    own = model.materials(points.positions)
    if not replaced.materials:
        return points, own
    alpha = truth["roughness"].clamp_min(SMOOTHEST).square()
    return points, Materials(
        torch.where(covered, truth["albedo"][:, :3] / ratio, own.albedo),
        torch.where(covered, alpha, own.alpha),
        torch.where(covered, truth["metallic"], own.metalness),
    )


@torch.no_grad()
def relit(
    model: InverseModel,
    view: View,
    light: MapLight,
    replaced: Replaced,
    ratio: Float[Tensor, "3"],
    arguments: argparse.Namespace,
    *,
    indirect: bool,
) -> Picture:
    """Return a view under `light`, as `render_relit` does, with the truth in place of what is `replaced`."""
    count = points_per_ray(arguments.antialias)

    def shade(points: ShadingPoints, generator: torch.Generator) -> Tensor:
        points, materials = with_truth(model, points, view, replaced, ratio)
        return relit_radiance(
            model,
            points,
            light,
            ratio,
            cache=model.fast_source(),
            num_directions=max(4, arguments.directions // (count * arguments.antialias**2)),
            indirect=indirect,
            generator=generator,
            materials=materials,
        )

    picture = monte_carlo(
        model,
        finer(view.camera, arguments.antialias),
        shade,
        num_repeats=1,
        points_per_ray=count,
        light=0,
        seed=0,
        purpose="relit",
    )
    return mean_picture(picture, arguments.antialias)


def albedo_ratio(model: InverseModel, views: tuple[View, ...], antialias: int) -> Float[Tensor, "3"]:
    """Return the median ratio per channel of true to found albedo where both cover the whole pixel."""
    true, found = [], []
    for view in views:
        surface, albedo = render_surface(model, view.camera, antialias=antialias), view.truth["albedo"]
        whole = (surface.opacity[..., 0] > 0.99) & (albedo[..., 3] > 0.99)
        true.append(albedo[whole][:, :3])
        found.append(surface.albedo[whole])
    return torch.tensor(median_albedo_ratio(np.concatenate(true), np.concatenate(found)), dtype=torch.float32)


def read_run(run_dir: Path, scene_dir: Path, num_views: int) -> tuple[InverseModel, Scene, tuple[View, ...]]:
    """Return the trained model, the scene with its truth under the light of the training, and test views."""
    context = open_task(run_dir, "joint", ConsoleReporter(), "cpu")
    trained = read_scene(context)
    model = load_trained(context, trained, "joint").eval().requires_grad_(False)
    manifest = select_lights(describe_scene(scene_dir), tuple(trained.lights))
    scene = load_scene(scene_dir, manifest, max_side=1 << 30)
    return model, scene, evenly_spaced(scene.test, num_views)


def measure(
    model: InverseModel,
    views: tuple[View, ...],
    maps: Mapping[str, Float32[ndarray, "rows columns 3"]],
    arguments: argparse.Namespace,
) -> dict[str, dict[str, float]]:
    """Write all pictures, and return the figures by row, light and bounce."""
    ratio = albedo_ratio(model, views, arguments.antialias)
    lights = {name: MapLight.from_image(image, torch.device("cpu")) for name, image in maps.items()}
    table: dict[str, dict[str, float]] = {}
    for row, replaced in ROWS.items():
        table[row] = {}
        for bounce, indirect in (("direct", False), ("one bounce", True)):
            out = arguments.out / row.replace(" ", "_") / bounce.replace(" ", "_")
            for view in views:
                for name, light in lights.items():
                    picture = relit(model, view, light, replaced, ratio, arguments, indirect=indirect)
                    save_array(out / view.name / f"rgba_{name}.npy", encoded(picture.rgb, picture.opacity))
            scores = reference_scores(arguments.scene, out, arguments.views)
            table[row] |= {f"{name}, {bounce}": scores[f"rgb/{name}/psnr"] for name in lights}
            table[row][f"both, {bounce}"] = scores["relight/psnr"]
    return table


def main() -> None:
    """Print one table, and write its figures to OUT/oracle_points.json."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--views", type=int, default=5, help="test views, evenly spaced; 0 for all")
    parser.add_argument("--directions", type=int, default=256, help="secondary rays per pixel")
    parser.add_argument("--antialias", type=int, default=2, help="camera rays along a pixel's side")
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    prepare()
    model, scene, views = read_run(arguments.run, arguments.scene, arguments.views)
    maps = read_maps(arguments.environments, tuple(scene.relight_lights))
    table = measure(model, views, maps, arguments)
    lights = [*maps, "both"]
    print(f"\n{scene.name}, {len(views)} views; direct light / one bounce [dB]\n")
    print("| where the camera looks | " + " | ".join(lights) + " |\n" + "| --- " * (len(lights) + 1) + "|")
    for row, figures in table.items():
        pairs = [(figures[f"{name}, direct"], figures[f"{name}, one bounce"]) for name in lights]
        print(f"| {row} | " + " | ".join(f"{direct:.2f} / {bounce:.2f}" for direct, bounce in pairs) + " |")
    (arguments.out / "oracle_points.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
