"""Score what is made of the tabletop captures: cameras, masks, and pictures under lights never photographed.

    python -m benchmarks photographs SUITE/carpet SUITE/sheet -o OUT
    python -m benchmarks photographs SUITE/* --run 'RUNS/{name}'
    python -m benchmarks photographs SUITE/* --write-known KNOWN

The captures come from `examples/make_tabletop_capture.py`. Cameras are compared after the similarity that
brings their centres closest to the true ones; without `--cameras` they are solved here, into OUT. Masks are
compared by IoU, cut at one half. The bundle of a run is relit in the unseen lights at the true held-out
cameras, which the cameras it was trained with bring into its world; its albedo takes the median ratio to the
truth. The object is relit alone, without what it stood on, and so is the truth. `--write-known` writes
captures with true cameras and masks instead, to be trained for comparison.
"""

import argparse
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from lambent.truth import psnr
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.layouts.photographs import CAMERAS_FILE, read_capture
from lambent_capture.poses.capture import RECORD, solve_capture
from lambent_capture.poses.solve import PoseSettings
from lambent_capture.problems import Problems
from lambent_core.colour import srgb_from_linear
from lambent_core.directions import pixel_directions
from lambent_core.errors import SceneRefusedError
from lambent_core.files import read_record
from lambent_relight import Camera, Environment, Renderer, environment_from_array, load_bundle
from lambent_run.run.capture import MANIFEST
from numpy import ndarray
from PIL import Image

from benchmarks.painted_scene import overlap
from benchmarks.pose_errors import Similarity, pose_errors, similarity
from benchmarks.tabletop_truth import (
    HeldOut,
    as_stored,
    held_out_views,
    pose,
    read_coverage,
    stored_pose,
    true_cameras,
    unseen_lights,
    write_known,
)

QUICK = "tests/data/tabletop/carpet --few photographs"

LIGHT_ROWS = 512
PICTURES = (".png", ".jpg", ".jpeg")


def camera_scores(
    solved: dict[str, Float[ndarray, "4 4"]], capture: Path, photographs: str
) -> dict[str, float]:
    """Return the share of registered photographs and the errors of their cameras; `solved` is by stem."""
    true = true_cameras(capture)
    stems = {path.stem for path in (capture / photographs).iterdir()}
    common = sorted(stems & set(solved))
    scores = {
        "photographs": len(stems),
        "registered": len(common),
        "registered_share": len(common) / len(stems),
    }
    if len(common) < 3:
        return scores
    rotation, centre = pose_errors(
        np.array([solved[stem] for stem in common]), np.array([stored_pose(true[stem]) for stem in common])
    )
    return scores | {
        "rotation_deg_median": float(np.median(rotation)),
        "rotation_deg_max": float(rotation.max()),
        "centre_share_median": float(np.median(centre)),
        "centre_share_max": float(centre.max()),
    }


def solved_cameras(folder: Path, pictures: Path) -> dict[str, Float[ndarray, "4 4"]]:
    """Return camera-to-world by stem of the photographs of any capture that Lambent reads.

    `folder` may also be the cameras that a run has found for the photographs in `pictures`.
    """
    if (folder / CAMERAS_FILE).is_file():
        frames = read_capture(pictures, Problems(), folder).frames
    else:
        frames = describe_scene(folder).frames
    return {
        Path(frame.images[0].path).stem: np.array(frame.camera.camera_to_world).reshape(4, 4)
        for frame in frames
    }


def mask_scores(masks: Path, capture: Path) -> dict[str, Any]:
    """Return the IoU of each mask in `masks` with the true one of the same stem, mean and worst.

    A mask of another size is brought to the truth's. Raises `SystemExit` where no mask has a true one.
    """
    truth = {path.stem: path for path in (capture / "truth" / "masks").glob("*.png")}
    scores = {
        path.name.partition(".")[0]: path for path in sorted(masks.rglob("*")) if path.suffix in PICTURES
    }
    common = sorted(set(truth) & set(scores))
    if not common:
        raise SystemExit(f"no picture in {masks} is named like a photograph of {capture.name}")
    iou = {}
    for stem in common:
        true, mine = read_coverage(truth[stem]), read_coverage(scores[stem])
        true = as_stored(true, true_cameras(capture)[stem]["orientation"])
        if mine.shape != true.shape:
            resized = Image.fromarray(mine.astype(np.float32)).resize(
                true.shape[::-1], Image.Resampling.BILINEAR
            )
            mine = np.asarray(resized, np.float64)
        iou[stem] = round(overlap(mine, true), 4)
    worst = min(iou, key=lambda stem: iou[stem])
    return {
        "masks": len(common),
        "iou_mean": statistics.mean(iou.values()),
        "iou_worst": iou[worst],
        "iou_worst_view": worst,
        "iou": iou,
    }


def bundle_to_truth(run: Path, capture: Path) -> Similarity:
    """Return the similarity from the world of a run and its bundle to the truth's, by the cameras of both."""
    true = true_cameras(capture)
    # Where masks were estimated, the box around the object has been fitted to them.
    fitted = run / "estimated_masks" / MANIFEST
    frames = read_record(fitted if fitted.is_file() else run / "scene" / MANIFEST).get("frames", [])
    cameras = {Path(frame["name"]).name.partition(".")[0]: frame["camera"] for frame in frames}
    common = sorted(set(true) & set(cameras))
    if len(common) < 3:
        raise SystemExit(f"the cameras of {run} are not those of {capture.name}: {sorted(cameras)[:5]}")
    centres = np.array([np.reshape(cameras[stem]["camera_to_world"], (4, 4))[:3, 3] for stem in common])
    return similarity(centres, np.array([pose(true[stem])[:3, 3] for stem in common]))


def turned_light(light: Environment, rotation: Float[ndarray, "3 3"]) -> Environment:
    """Return the light as seen from a world whose directions d are `rotation` d in the light's own."""
    directions = pixel_directions(LIGHT_ROWS, 2 * LIGHT_ROWS) @ rotation.T
    return environment_from_array(light.lookup(directions))


def brought_into(camera: Camera, to_truth: Similarity) -> Camera:
    """Return a camera of the truth in the bundle's world."""
    matrix = to_truth.inverse().poses(camera.camera_to_world[None])[0]
    names = ("name", "width", "height", "focal_x", "focal_y", "centre_x", "centre_y")
    return Camera(camera_to_world=matrix, **{name: getattr(camera, name) for name in names})


def over_white(
    premultiplied: Float[ndarray, "h w 3"], coverage: Float[ndarray, "h w 1"]
) -> Float[ndarray, "h w 3"]:
    """Return sRGB-encoded straight colours over white, composited in encoded values."""
    straight = premultiplied / np.maximum(coverage, 1e-6)
    return srgb_from_linear(np.clip(straight, 0.0, 1.0)) * coverage + 1.0 - coverage


def median_ratio(renderer: Renderer, views: list[HeldOut], cameras: list[Camera]) -> Float[ndarray, " 3"]:
    """Return the median of true over found albedo where both cover the whole pixel, per channel."""
    ratios = []
    for view, camera in zip(views, cameras, strict=True):
        seen = renderer.caches.gbuffer(*camera.rays())
        coverage = next(iter(view.relit.values()))[..., 3].reshape(-1)
        inside = (coverage > 0.99) & (np.asarray(seen.opacity).reshape(-1) > 0.9)
        ratios.append(view.albedo.reshape(-1, 3)[inside] / np.maximum(seen.albedo[inside], 1e-6))
    all_ratios = np.concatenate(ratios)
    if not len(all_ratios):
        raise SystemExit(
            "the bundle's object and the true one cover no pixel in common; are its cameras right?"
        )
    return np.median(all_ratios, axis=0)


def relight_scores(run: Path, capture: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return PSNR over held-out views by unseen light and their mean, and write what was compared to OUT."""
    to_truth = bundle_to_truth(run, capture)
    lights = unseen_lights(capture)
    views = held_out_views(capture, list(lights), options.shrink)[: options.views]
    cameras = [brought_into(view.camera, to_truth) for view in views]
    renderer = Renderer(load_bundle(run / "bundle"))
    ratio = median_ratio(renderer, views, cameras)
    scores: dict[str, Any] = {"albedo_ratio": ratio.tolist()}
    for name, light in lights.items():
        turned, decibels = turned_light(light, to_truth.rotation), []
        for view, camera in zip(views, cameras, strict=True):
            picture = renderer.render(
                camera, turned, spp=options.samples, albedo_ratio=ratio, seed=options.seed
            )
            mine = over_white(picture.rgb * picture.opacity, picture.opacity)
            true = over_white(view.relit[name][..., :3], view.relit[name][..., 3:])
            decibels.append(psnr(mine, true))
            both = np.concatenate([mine, true], axis=1)
            sheet = Image.fromarray(np.round(255.0 * both).astype(np.uint8))
            sheet.save(options.out / f"{capture.name}_{run.parent.name}_{view.name}_{name}.png")
        scores[f"relit_{name}_db"] = statistics.mean(decibels)
    scores["relit_db"] = statistics.mean(scores[f"relit_{name}_db"] for name in lights)
    return scores


def solved_here(capture: Path, options: argparse.Namespace) -> Path | None:
    """Return the folder of cameras found by `lambent poses`, or None after saying why there are none."""
    target = options.out / capture.name / "cameras"
    try:
        solve_capture(capture / options.few, target, None, PoseSettings(seed=options.seed))
    except SceneRefusedError as error:
        print(f"{capture.name}: {error.report.findings[0].message}")
        return None
    return target


def score(capture: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Return the scores of every result of a capture."""
    scores: dict[str, Any] = {}
    if options.run:
        run = _of(options.run, capture)
        cameras, masks = run / "cameras", run / "estimated_masks" / "masks"
        taken = read_record(run / "evaluation" / "report.json").get("seconds", {})
        scores |= {f"{task}_s": seconds for task, seconds in taken.items()}
    else:
        run, masks = None, _of(options.masks, capture) if options.masks else None
        began, cpu = time.perf_counter(), time.process_time()
        cameras = _of(options.cameras, capture) if options.cameras else solved_here(capture, options)
        if not options.cameras:
            scores |= {"solve_s": time.perf_counter() - began, "solve_cpu_s": time.process_time() - cpu}
    if cameras is not None and cameras.is_dir():
        solved = solved_cameras(cameras, capture / options.few)
        scores |= camera_scores(solved, capture, options.few)
        recorded = read_record(cameras / CAMERAS_FILE) or read_record(cameras / RECORD)
        if "reprojection_error_px" in recorded:
            scores["reprojection_error_px"] = recorded["reprojection_error_px"]
    if masks is not None and masks.is_dir():
        scores |= mask_scores(masks, capture)
    if run is not None and (run / "bundle").is_dir():
        scores |= relight_scores(run, capture, options)
    return scores


def _of(pattern: str, capture: Path) -> Path:
    return Path(pattern.replace("{name}", capture.name))


COLUMNS = {
    "registered_share": "registered",
    "reprojection_error_px": "reprojection [px]",
    "rotation_deg_median": "rotation, median [deg]",
    "rotation_deg_max": "rotation, worst [deg]",
    "centre_share_max": "centre, worst [share]",
    "iou_mean": "IoU, mean",
    "iou_worst": "IoU, worst",
    "relit_db": "relit [dB]",
}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the benchmark."""
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--few", default="photographs", help="photographs or photographs-16")
    parser.add_argument("--cameras", help="folder of found cameras, any layout; {name} is the capture's name")
    parser.add_argument("--masks", help="folder of estimated masks; {name} is the capture's name")
    parser.add_argument("--run", help="run folder, instead: its cameras, masks and bundle, where it has them")
    parser.add_argument("--write-known", type=Path, help="write captures with true cameras and masks here")
    parser.add_argument("--views", type=int, default=4, help="held-out views to relight")
    parser.add_argument("--samples", type=int, default=64, help="light directions per pixel")
    parser.add_argument("--shrink", type=int, default=1, help="times fewer pixels per side in relit pictures")
    parser.add_argument("--seed", type=int, default=0)


def main(options: argparse.Namespace) -> dict[str, dict]:
    """Score, print the table, and return all figures by capture."""
    if options.write_known:
        for capture in options.captures:
            write_known(capture, options.few, options.write_known / capture.name)
            print(f"{options.write_known / capture.name}")
        return {}
    record = {}
    print("| capture | " + " | ".join(COLUMNS.values()) + " |")
    print("| --- |" + " --- |" * len(COLUMNS))
    for capture in options.captures:
        record[capture.name] = scores = score(capture, options)
        shown = [f"{scores[key]:.3f}" if key in scores else "" for key in COLUMNS]
        print(f"| {capture.name} | " + " | ".join(shown) + " |", flush=True)
    return record
