"""Fifth task: the bundle, complete and compared with the model, or not there at all."""

import copy
import re
import shutil
from collections.abc import Callable
from pathlib import Path

from flashcache.data.scene import Scene
from flashcache.export.reference import GbufferRule
from flashcache.physical.model import InverseModel
from flashcache.training.checkpoint import latest_checkpoint
from lambent_proto.v1 import bundle_pb2
from lambent_relight.cameras import cameras_json
from lambent_relight.environment.maps import write_environment

from lambent_worker.bundle.cameras import relight_camera
from lambent_worker.bundle.graphs import remove_networks, write_graphs
from lambent_worker.bundle.half_tables import MOST_ROUNDING, fits_half, with_half_tables
from lambent_worker.bundle.manifest import new_manifest, write_manifest
from lambent_worker.bundle.measure import measure
from lambent_worker.bundle.mesh import occupied_box
from lambent_worker.bundle.parity import ParityResult
from lambent_worker.bundle.surface_files import write_asset, written_caches
from lambent_worker.bundle.transport import TransportConfig
from lambent_worker.bundle.transport_files import write_relight_graph, write_transport
from lambent_worker.bundle.transport_quality import judge_qualities
from lambent_worker.bundle.transport_rays import MESH_RAYS
from lambent_worker.bundle.uncertainty import write_uncertainty
from lambent_worker.errors import WorkerError
from lambent_worker.files import read_record
from lambent_worker.run.context import TaskContext
from lambent_worker.run.folder import task_folder
from lambent_worker.run.hashes import scene_hash
from lambent_worker.run.tasks.training import load_final, read_scene
from lambent_worker.run.uncertainty import uncertainty_of_run

NUM_PARTS = 8
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
        write_bundle(context, scene, model, partial)
        shutil.rmtree(context.folder, ignore_errors=True)
        partial.rename(context.folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    context.reporter.artifact("asset.glb", context.folder / "mesh" / "asset.glb")


def write_bundle(context: TaskContext, scene: Scene, model: InverseModel, folder: Path) -> None:
    """Fill `folder`, whose sub-folders exist, with everything a bundle has."""
    settings = context.spec.config.export
    box = occupied_box(model)
    _advance(context, 1)

    rule = GbufferRule(box_min=box[0], box_max=box[1], num_samples=settings.gbuffer_samples)
    manifest = new_manifest(
        model,
        box,
        name=scene.name,
        preset=context.spec.config.preset,
        scene_id=scene_hash(context.spec.scene),
        train_step=train_step(context),
    )
    manifest.train_lights.extend(light_names(model.domain.lights))

    def compared(path: str, result: ParityResult) -> None:
        context.reporter.log(
            "graph.compared",
            path=path,
            max_abs_error=result.max_abs_error,
            num_samples=result.num_samples,
            num_left_out=result.num_left_out,
        )
        _advance(context, {"models/gbuffer.onnx": 2, "models/relight.onnx": 5}.get(path, 3))

    trained = model
    model = _write_networks(context, at_reference(model), rule, manifest, folder, compared)
    caches = written_caches(manifest, folder)
    surface = write_asset(model, caches, settings, manifest, folder, box=box, views=scene.train or scene.test)
    _advance(context, 4)
    if settings.transport_tier != "none":
        write_transport(
            caches,
            surface,
            manifest,
            folder,
            TransportConfig(tier=settings.transport_tier, rays=MESH_RAYS),
            store=context.folder.with_name(context.folder.name + ".rays"),
            advance=lambda share: context.stop_if_asked(),
        )
        compared("models/relight.onnx", write_relight_graph(manifest, folder, seed=context.spec.seed))
    _advance(context, 5)

    views = scene.test or scene.train
    cameras = [relight_camera(view.name, view.camera) for view in views]
    (folder / "cameras.json").write_text(cameras_json(cameras), encoding="utf-8")
    recovered = {
        light: model.environment.image(settings.environment_height, index).cpu().numpy()
        for index, light in enumerate(manifest.train_lights)
    }
    for light, image in recovered.items():
        write_environment(folder / "env" / f"trained_{light}.exr", image)
    _advance(context, 6)
    manifest.metrics.update(measure(model, caches, surface, views, scene.lights[0], folder / "preview"))
    if settings.transport_tier != "none" and settings.judge_samples:
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
    if settings.weights == "none":
        remove_networks(manifest, folder)
    _advance(context, 7)
    uncertainty = uncertainty_of_run(context, trained if scene.turned else model, scene)
    if uncertainty is not None:
        write_uncertainty(folder, manifest, uncertainty)
    for picture in sorted((context.run_dir / "previews").glob("*.png")):
        # The evaluation's sheet of all test views is a fifth of a megabyte, and in its report.
        if picture.name != "evaluation.png":
            shutil.copyfile(picture, folder / "preview" / picture.name)
    files = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    write_manifest(folder, manifest, sorted(files))
    _advance(context, NUM_PARTS)
    context.reporter.log("exported", **{name: round(value, 6) for name, value in manifest.metrics.items()})


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
    wanted = context.spec.config.export.weights
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
