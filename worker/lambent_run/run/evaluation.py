"""The evaluation of a trained run on a capture, with its environments and its folder: `lambent evaluate`."""

import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np
from flashcache.evaluation.lpips import load_lpips
from flashcache.physical.model import InverseModel
from jaxtyping import Float32
from lambent_capture.checks.exposure_estimate import adopt_exposures
from lambent_capture.layouts.detect import describe_scene, detect_layout
from lambent_capture.loading.light_turns import adopt_light
from lambent_capture.loading.lights import select_lights
from lambent_capture.loading.load import load_scene
from lambent_capture.scenes.world import in_world, world_matrix
from lambent_core.errors import RelightError, UsageError
from lambent_core.files import digest, read_record, write_json
from lambent_core.layouts import PHOTOGRAPHS
from lambent_core.reporter import Reporter
from lambent_core.scene import Scene
from lambent_proto.v1 import evaluation_pb2, scene_pb2
from lambent_relight.bundle.uncertainty import UncertaintyGrid
from lambent_relight.environment.maps import load_environment
from numpy import ndarray

from lambent_run.report import protocol
from lambent_run.report.request import EvaluationRequest
from lambent_run.run.capture import found_cameras, left_out_of, read_manifest, use_own_masks
from lambent_run.run.context import TaskContext
from lambent_run.run.folder import done_inputs, require_done
from lambent_run.run.hashes import cameras_inputs, last_training_task, scene_hash
from lambent_run.run.prepare import open_task
from lambent_run.run.tasks.evaluate import evaluated, subject_of
from lambent_run.run.tasks.training import load_final, read_scene
from lambent_run.run.true_lights import FOLDER, maps_in, read_true_lights
from lambent_run.run.uncertainty import kept_uncertainty, uncertainty_of_run

ANY_SIZE = 1 << 30


def evaluate_run(
    run_dir: Path, scene_dir: Path, out: Path, request: EvaluationRequest, *, device: str, reporter: Reporter
) -> evaluation_pb2.EvaluationReport:
    """Evaluate a trained run on the views of `scene_dir` and return what is in `out/report.json`.

    Called again with the same arguments it keeps the pictures that exist. Raises `UsageError` for a run
    that is not trained, an environment folder without usable maps, or an `out` that holds something else, and
    `SceneRefusedError` for a scene that cannot be read.
    """
    context = open_task(run_dir, "evaluate", reporter, device)
    trained = require_done(run_dir, last_training_task(context.spec.config))
    scene, manifest = _scene_to_compare(context, scene_dir, request)
    given = [] if request.environments is None else [request.environments]
    named = read_true_lights(scene.lights, given)
    maps = read_maps(request.environments, tuple(manifest.relight_lights), needed=not named)
    true_lights = read_true_lights(scene.lights, [scene_dir / FOLDER]) | named
    # What is computed from pictures, or written beside them, does not make them others.
    settings = {
        name: value for name, value in asdict(request).items() if name not in ("lpips_weights", "exr")
    }
    settings |= {"environments": sorted(maps), "scene": scene_hash(scene_dir), "protocol": protocol.VERSION}
    lpips = load_lpips(request.lpips_weights) if request.lpips_weights else None
    _prepare_out(out, digest(trained, settings, [float(image.sum()) for _, image in sorted(maps.items())]))
    model = load_final(context, trained_scene(context))
    subject = subject_of(
        context,
        request,
        model=model,
        scene=scene,
        maps=maps,
        out=out,
        dataset=manifest.layout,
        lpips=lpips,
        uncertainty=_uncertainty(context, model),
        true_lights=true_lights,
    )
    return evaluated(context, subject)


def read_maps(
    folder: Path | None, lights: tuple[str, ...], *, needed: bool = True
) -> dict[str, Float32[ndarray, "rows columns 3"]]:
    """Return the environment maps in `folder` that are named like one of `lights`, linear radiance.

    Raises `UsageError` where the folder is not there, a map cannot be read, or, if one is `needed`, none is
    named like a light.
    """
    if folder is None:
        return {}
    if not folder.is_dir():
        raise UsageError("evaluate.environments_missing", f'--environments "{folder}" is not a folder')
    files = maps_in(folder)
    maps = {}
    for light in lights:
        if light not in files:
            continue
        try:
            maps[light] = np.ascontiguousarray(load_environment(files[light]).radiance, dtype=np.float32)
        except RelightError as error:
            raise UsageError("evaluate.environment_unreadable", str(error)) from error
    if not maps and needed:
        raise UsageError(
            "evaluate.environments_unmatched",
            f'"{folder}" has no .hdr or .exr map named like a light of the scene '
            f"(to relight in: {', '.join(lights) or 'none'}); rename the maps or leave --environments out",
        )
    return maps


def _scene_to_compare(
    context: TaskContext, scene_dir: Path, request: EvaluationRequest
) -> tuple[Scene, scene_pb2.SceneManifest]:
    """Return the capture with the run's training lights, without the photographs that are not needed."""
    layout, cameras = context.spec.layout or None, _cameras_for(context, scene_dir)
    full = describe_scene(scene_dir, layout, left_out=left_out_of(context, scene_dir), cameras=cameras)
    trained = read_manifest(context)
    trained_lights = tuple(trained.lights)
    missing = [light for light in trained_lights if light not in full.lights]
    if missing:
        raise UsageError(
            "evaluate.light_missing",
            f'"{scene_dir}" has no photographs under {", ".join(missing)}, the light the run was trained in; '
            "give the capture it was trained on, or another one in the same light",
        )
    manifest = select_lights(full, trained_lights)
    in_world(manifest, world_matrix(trained))
    adopt_light(manifest, trained)
    use_own_masks(context, scene_dir, manifest, trained)
    adopt_exposures(manifest.frames, trained.frames)
    if any(frame.split == scene_pb2.SPLIT_TEST for frame in manifest.frames):
        frames = [frame for frame in manifest.frames if frame.split == scene_pb2.SPLIT_TEST]
        del manifest.frames[:]
        manifest.frames.extend(frames)
    size, crop = request.max_side or ANY_SIZE, context.config.crop
    return load_scene(scene_dir, manifest, max_side=size, crop=crop), manifest


def _cameras_for(context: TaskContext, scene_dir: Path) -> Path | None:
    """Return the cameras that the run found for these photographs; raises `UsageError` for other ones."""
    if (context.spec.layout or detect_layout(scene_dir)) != PHOTOGRAPHS:
        return None
    cameras = found_cameras(context.run_dir)
    if cameras is None or done_inputs(context.run_dir, "cameras") != cameras_inputs(scene_dir, context.spec):
        raise UsageError(
            "evaluate.cameras_missing",
            f'"{scene_dir}" holds photographs without cameras, and not those that the run was trained on; '
            "give those, or a capture with cameras in the same coordinates",
        )
    return cameras


def trained_scene(context: TaskContext) -> Scene:
    """Return the scene the model was trained in, without pictures: the space it lives in."""
    manifest = read_manifest(context)
    del manifest.frames[:]
    return load_scene(context.spec.scene, manifest, max_side=ANY_SIZE)


def _uncertainty(context: TaskContext, model: InverseModel) -> UncertaintyGrid | None:
    """Return the uncertainty of the run's materials; None where it was not kept and its capture is gone."""
    kept = kept_uncertainty(context.run_dir)
    if kept is not None or not context.spec.scene.is_dir():
        return kept
    return uncertainty_of_run(context, model, read_scene(context))


def _prepare_out(out: Path, inputs: str) -> None:
    """Keep predictions that were made from the same inputs, and remove others of ours."""
    marker = out / "inputs.json"
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not marker.is_file())):
        raise UsageError(
            "evaluate.folder_not_empty", f'"{out}" holds something else; choose another folder with -o'
        )
    if marker.is_file() and read_record(marker).get("sha256") != inputs:
        shutil.rmtree(out)
    out.mkdir(parents=True, exist_ok=True)
    write_json(marker, {"sha256": inputs})
