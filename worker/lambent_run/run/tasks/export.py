"""Fifth task: the bundle, complete and compared with the model, or not there at all."""

import copy
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from flashcache.export.reference import GbufferRule
from flashcache.physical.model import InverseModel
from flashcache.training.checkpoint import latest_checkpoint
from lambent_asset.bundle.graphs import remove_networks, write_graphs
from lambent_asset.bundle.manifest import new_manifest, write_manifest, write_uncertainty
from lambent_asset.bundle.parity import MOST_ROUNDING, ParityResult, fits_half, with_half_tables
from lambent_asset.bundle.poster import try_poster
from lambent_asset.bundle.surface_files import pixel_size, write_asset, written_caches
from lambent_asset.bundle.transport_files import baked_transport, write_relight_graph
from lambent_asset.mesh.mesh import Corner, occupied_box
from lambent_asset.mesh.mesh_depth import relight_camera
from lambent_asset.textures.photo_albedo import Photographs, albedo_texture, automatic_size
from lambent_asset.textures.surface import AtlasSurface, build_surface
from lambent_asset.transport.transport import TransportConfig, write_transport
from lambent_asset.transport.transport_quality import judge_qualities
from lambent_asset.transport.transport_rays import MESH_RAYS
from lambent_capture.loading.load import camera_of, full_size_views
from lambent_core.errors import WorkerError
from lambent_core.files import read_record
from lambent_core.scene import Camera, Scene, View
from lambent_proto.v1 import bundle_pb2, scene_pb2
from lambent_relight.baked.mesh import AtlasMesh
from lambent_relight.baked.scene import baked_scene
from lambent_relight.baked.transport import Transport
from lambent_relight.bundle.graphs import SurfaceCaches
from lambent_relight.cameras import Camera as RelightCamera
from lambent_relight.cameras import cameras_json
from lambent_relight.environment.maps import write_environment
from numpy.typing import NDArray

from lambent_run.report.measure import measure
from lambent_run.run.capture import read_manifest
from lambent_run.run.context import TaskContext
from lambent_run.run.export_notes import tell_about
from lambent_run.run.folder import task_folder
from lambent_run.run.hashes import scene_hash
from lambent_run.run.live_preview import NAME as PREVIEW_NAME
from lambent_run.run.tasks.training import load_final, read_scene
from lambent_run.run.uncertainty import uncertainty_of_run

NUM_PARTS = 8
FINER = 1.25
"""Photographs give the albedo texture detail if the trained ones were reduced by this factor at least."""
FOLDERS = ("models", "mesh", "env", "preview")


def run(context: TaskContext) -> None:
    """Write `bundle/`: built beside its place and moved there when everything in it has been checked.

    Raises WorkerError with an `export.*` code when a graph differs from the model, or there is no surface.
    """
    scene = read_scene(context)
    model = load_final(context, scene).eval()
    partial = context.folder.with_name(context.folder.name + ".partial")
    shutil.rmtree(partial, ignore_errors=True)
    for name in FOLDERS:
        (partial / name).mkdir(parents=True)
    try:
        manifest = write_bundle(context, scene, model, partial)
        shutil.rmtree(context.folder, ignore_errors=True)
        partial.rename(context.folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    context.reporter.artifact("asset.glb", context.folder / "mesh" / "asset.glb")
    tell_about(context.reporter, manifest, context.config.export)


def write_bundle(
    context: TaskContext, scene: Scene, model: InverseModel, folder: Path
) -> bundle_pb2.BundleManifest:
    """Fill `folder`, whose sub-folders exist, with everything a bundle has; return its manifest."""
    settings = context.config.export
    box = occupied_box(model)
    _advance(context, 1)

    rule = GbufferRule(box_min=box[0], box_max=box[1], num_samples=settings.gbuffer_samples)
    manifest = manifest_of(context, scene, model, box)
    trained = model

    def compared(path: str, result: ParityResult) -> None:
        context.reporter.log(
            "graph.compared",
            path=path,
            max_abs_error=result.max_abs_error,
            num_samples=result.num_samples,
            num_left_out=result.num_left_out,
        )
        _advance(context, {"models/gbuffer.onnx": 2, "models/relight.onnx": 5}.get(path, 3))

    model = _write_networks(context, at_reference(model), rule, manifest, folder, compared)
    caches = written_caches(manifest, folder)
    recovered = write_environments(context, model, manifest, folder)
    surface = _write_surface(context, scene, model, caches, manifest, folder, recovered, box)
    if settings.transport_tier != "none":
        compared("models/relight.onnx", write_relight_graph(manifest, folder, seed=context.spec.seed))
    _advance(context, 5)

    views = scene.test or scene.train
    cameras = write_cameras(views, folder)
    _advance(context, 6)
    manifest.metrics.update(measure(model, caches, surface, views, scene.lights[0], folder / "preview"))
    _judge(context, manifest, folder, cameras, recovered)
    if settings.weights == "none":
        remove_networks(manifest, folder)
    add_poster(context, manifest, folder)
    _advance(context, 7)
    uncertainty = uncertainty_of_run(context, trained if scene.turned else model, scene)
    if uncertainty is not None:
        write_uncertainty(folder, manifest, uncertainty)
    for picture in sorted((context.run_dir / "previews").glob("*.png")):
        # The evaluation's sheet of all test views is a fifth of a megabyte, and in its report; how far the
        # training was when a preview was made depends on the machine.
        if picture.name != "evaluation.png" and not picture.name.startswith(PREVIEW_NAME.format(task="")):
            shutil.copyfile(picture, folder / "preview" / picture.name)
    write_manifest(folder, manifest)
    _advance(context, NUM_PARTS)
    context.reporter.log("exported", **{name: round(value, 6) for name, value in manifest.metrics.items()})
    return manifest


def manifest_of(
    context: TaskContext, scene: Scene, model: InverseModel, box: tuple[Corner, Corner]
) -> bundle_pb2.BundleManifest:
    """Return the beginning of a run's manifest: everything that is known before anything is written."""
    manifest = new_manifest(
        model,
        box,
        name=scene.name,
        preset=context.config.preset,
        scene_id=scene_hash(context.spec.scene),
        train_step=train_step(context),
    )
    manifest.train_lights.extend(light_names(model.domain.lights))
    return manifest


def write_environments(
    context: TaskContext, model: InverseModel, manifest: bundle_pb2.BundleManifest, folder: Path
) -> dict[str, NDArray[np.float32]]:
    """Write the recovered environments into `folder`/env, and return them by light."""
    height = context.config.export.environment_height
    recovered = {
        light: model.environment.image(height, index).detach().cpu().numpy()
        for index, light in enumerate(manifest.train_lights)
    }
    for light, image in recovered.items():
        write_environment(folder / "env" / f"trained_{light}.exr", image)
    return recovered


def write_cameras(views: Sequence[View], folder: Path) -> list[RelightCamera]:
    """Write the cameras of views into `folder`, and return them."""
    cameras = [relight_camera(view.name, view.camera) for view in views]
    (folder / "cameras.json").write_text(cameras_json(cameras), encoding="utf-8")
    return cameras


def add_poster(context: TaskContext, manifest: bundle_pb2.BundleManifest, folder: Path) -> None:
    """Write the pictures by which people recognise the bundle, which does without where that fails."""
    if problem := try_poster(folder, manifest):
        context.reporter.log("poster.failed", reason=problem)


def _judge(
    context: TaskContext,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
    cameras: Sequence[RelightCamera],
    recovered: Mapping[str, NDArray[np.float32]],
) -> None:
    """Add metrics of baked pictures compared with refined ones."""
    settings = context.config.export
    if settings.transport_tier == "none" or not settings.judge_samples:
        return
    judged = judge_qualities(
        folder,
        manifest,
        cameras[:1],
        recovered,
        num_samples=settings.judge_samples,
        seed=context.spec.seed,
        networks=settings.weights != "none",
    )
    manifest.metrics.update(judged)


def _write_surface(
    context: TaskContext,
    scene: Scene,
    model: InverseModel,
    caches: SurfaceCaches,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
    recovered: Mapping[str, NDArray[np.float32]],
    box: tuple[Corner, Corner],
) -> AtlasSurface:
    """Write the transport, unless it is left out, and the mesh with its textures; return the surface.

    Shading that baked transport predicts is what turns photographs into albedo, so it is baked in any case.
    """
    settings = context.config.export
    views = (*scene.train, *scene.test)
    pixel = pixel_size((view.camera for view in views), box)
    surface = build_surface(model, settings, box=box, pixel_size=pixel, views=scene.train or scene.test)
    tier, albedo = settings.transport_tier, None

    def baked(share: float) -> None:
        # A server takes a run for stalled whose progress stands still.
        context.progress(round(100 * share), 100, doing="light", part=(3 / NUM_PARTS, 4 / NUM_PARTS))
        context.stop_if_asked()

    if tier != "none" or settings.albedo == "photographs":
        transport, figures = baked_transport(
            caches,
            surface,
            folder,
            TransportConfig(tier="lite" if tier == "none" else tier, rays=MESH_RAYS),
            store=context.folder.with_name(context.folder.name + ".rays"),
            advance=baked,
        )
        if tier != "none":
            write_transport(transport, manifest, folder)
            manifest.metrics.update(figures)
        _advance(context, 4)
        if settings.albedo == "photographs":
            albedo, figures = _photographed_albedo(
                context, scene, surface, transport, recovered[manifest.train_lights[0]], box
            )
            manifest.metrics.update(figures)
    write_asset(model, surface, albedo, settings, manifest, folder)
    faults = {
        name: int(manifest.metrics[f"mesh_{name}"]) for name in ("boundary_edges", "non_manifold_edges")
    }
    if any(faults.values()):
        context.reporter.log("mesh.not_watertight", **faults)
    return surface


def _photographed_albedo(
    context: TaskContext,
    scene: Scene,
    surface: AtlasSurface,
    transport: Transport,
    radiance: NDArray[np.float32],
    box: tuple[Corner, Corner],
) -> tuple[NDArray[np.float32] | None, dict[str, float]]:
    """Return the albedo texture from the run's photographs under the first light, at their full size.

    None where these are hardly finer than the ones that were trained on: they would say nothing new.
    """
    light = scene.lights[0]
    cameras, photographs = photographs_of(context, light)
    finer = pixel_size((view.camera for view in scene.train), box) / max(pixel_size(cameras, box), 1e-12)
    if finer < FINER:
        context.reporter.log("texture.nothing_finer", finer=round(finer, 3))
        return None, {}
    settings = context.config.export
    size = settings.atlas_size or automatic_size(surface, pixel_size(cameras, box), settings.transport_tier)
    done = 0

    def read_one() -> None:
        nonlocal done
        done = min(done + 1, 2 * len(cameras))
        context.progress(done, 2 * len(cameras), doing="photograph", part=(4 / NUM_PARTS, 4.9 / NUM_PARTS))
        context.stop_if_asked()

    return albedo_texture(
        surface,
        baked_scene(AtlasMesh(surface.vertices, surface.faces, surface.uv), transport),
        size,
        photographs,
        light,
        radiance,
        read_one,
    )


def photographs_of(context: TaskContext, light: str) -> tuple[list[Camera], Photographs]:
    """Return the cameras of the run's training photographs, and what opens these at their full size."""
    manifest = read_manifest(context)
    frames = [frame for frame in manifest.frames if frame.split == scene_pb2.SPLIT_TRAIN]
    cameras = [camera_of(frame) for frame in frames]
    return cameras, lambda: full_size_views(context.spec.scene, manifest, light)


def _write_networks(
    context: TaskContext,
    model: InverseModel,
    rule: GbufferRule,
    manifest: bundle_pb2.BundleManifest,
    folder: Path,
    compared: Callable[[str, ParityResult], None],
) -> InverseModel:
    """Write the graphs and return the model they were made from: its tables are float16, or as trained.

    With the setting "auto" they are float16 unless that moves an output by more than `MOST_ROUNDING`, which
    is logged as a warning.
    """
    wanted = context.config.export.weights
    fits = fits_half(model)
    if wanted == "fp16" and not fits:
        raise WorkerError(
            "export.half_range",
            "a feature table holds numbers beyond the range of float16; export with --weights fp32",
        )
    if wanted in ("fp16", "auto") and fits:
        rounded = with_half_tables(model)
        write_graphs(rounded, rule, manifest, folder, trained=model, seed=context.spec.seed, advance=compared)
        worst = max((r.rms_error, g.path, r.output) for g in manifest.graphs for r in g.rounding)
        if wanted == "fp16" or worst[0] <= MOST_ROUNDING:
            return rounded
        context.reporter.log("export.full_precision", path=worst[1], output=worst[2], rms_error=worst[0])
        remove_networks(manifest, folder)
    write_graphs(model, rule, manifest, folder, seed=context.spec.seed, advance=compared)
    return model


def at_reference(model: InverseModel) -> InverseModel:
    """Return a model whose fast cache knows one light that stands still: that of the reference photograph.

    It is the model itself where the light does not turn; the NeRF cache and the environment stay as they are.
    """
    if model.fast.turns is None:
        return model
    still = copy.deepcopy(model)
    still.fast = model.fast.at_turn(0)
    return still


def light_names(lights: tuple[str, ...]) -> list[str]:
    """Return the lights' names as a bundle and its files use them: letters, digits, `_`, `-` and `.`."""
    names = [re.sub(r"[^A-Za-z0-9_.\-]", "_", light) for light in lights]
    if len(set(names)) == len(names):
        return names
    return [f"{name}_{index}" for index, name in enumerate(names)]


def _advance(context: TaskContext, done: int) -> None:
    context.progress(done, NUM_PARTS)
    context.stop_if_asked()


def train_step(context: TaskContext) -> int:
    """Return the number of stage two's steps behind the exported model."""
    folder = latest_checkpoint(task_folder(context.run_dir, "joint"))
    return int(read_record(folder / "state.json").get("step", 0)) if folder is not None else 0
