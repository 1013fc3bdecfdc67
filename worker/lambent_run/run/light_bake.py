"""Adapts the fast cache of a run or a bundle to an environment and writes the resulting bundle."""

import math
import re
import shutil
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from flashcache.errors import ConfigError
from flashcache.evaluation.relighting import MapLight
from flashcache.presets import preset as preset_of
from flashcache.training.bake_scene import ModelScene
from flashcache.training.light_bake import STAGE, BakeScene, LightBake, LightBakeConfig, adaptable
from jaxtyping import Float32
from lambent_asset.light_bake.adapted_bundle import write_adapted
from lambent_asset.light_bake.bundle_scene import bundle_scene, cache_of
from lambent_asset.light_bake.judge import judged, transported
from lambent_capture.pictures.resample import averaged
from lambent_core.directions import pixel_directions, pixel_solid_angles
from lambent_core.errors import RelightError, UsageError
from lambent_core.files import digest
from lambent_core.reporter import Reporter
from lambent_relight.bundle.adapted import AdaptedLight, environment_digest
from lambent_relight.bundle.bundle import Bundle, load_bundle
from lambent_relight.environment.maps import Environment, load_environment
from numpy import ndarray

from lambent_run.run.context import TaskContext
from lambent_run.run.evaluation import trained_scene
from lambent_run.run.folder import begin_task, locked, require_done, task_folder
from lambent_run.run.prepare import open_task
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks.training import drive, load_final

MAP_ROWS = 256
"""Rows to which larger environments are reduced, each pixel the mean of those it covers."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BakeRequest:
    """Settings of a light bake."""

    environment: Path
    name: str = ""
    """The light's name in the bundle; empty: the file name without suffix."""
    rotate_deg: float = 0.0
    """Rotation of the light about +z."""
    albedo_ratio: tuple[float, float, float] | None = None
    """Factor on the stored albedo; None: the bundle's own."""
    config: LightBakeConfig = field(default_factory=LightBakeConfig)
    seed: int = 0
    device: str = ""

    def __post_init__(self) -> None:
        ratio = self.albedo_ratio
        if ratio is not None and not (len(ratio) == 3 and all(0.0 < part < math.inf for part in ratio)):
            raise ConfigError(f"albedo_ratio must be three positive numbers, got {ratio}")
        if not math.isfinite(self.rotate_deg):
            raise ConfigError(f"rotate_deg must be an angle in degrees, got {self.rotate_deg}")


def bake_light(source: Path, out: Path, request: BakeRequest, reporter: Reporter) -> AdaptedLight:
    """Write to `out` the bundle of `source`, a run folder or a bundle, with a cache adapted to a light.

    With a run, the NeRF cache determines where secondary rays stop; with a bundle alone, its fast cache does.
    An interrupted bake resumes from its last checkpoint, in `OUT.work`. Raises `UsageError` for a source or
    an environment that cannot be used, and where `out` exists.
    """
    if out.exists():
        raise UsageError("bake.exists", f'"{out}" exists already; choose another folder with -o')
    run = None
    if (source / "run.json").is_file():
        run = open_task(source, "joint", reporter, request.device)
    bundle, environment = _opened(source, run, request)
    light = AdaptedLight(
        name=_free_name(bundle, request),
        environment_sha256=environment_digest(environment),
        rotate_deg=request.rotate_deg % 360.0,
        albedo_ratio=request.albedo_ratio or _scale_of(bundle),
    )
    work = out.with_name(out.name + ".work")
    files = sorted(file.sha256 for file in bundle.manifest.files)
    inputs = digest(files, light.to_json(), asdict(request.config), request.seed, run is None)
    with locked(work):
        context = _context(run, source, work, request, reporter)
        begin_task(work, STAGE, inputs)
        scene = _scene(run, bundle, light)
        image = light_image(environment)
        stage = LightBake(
            adaptable(cache_of(bundle, bundle.manifest.train_lights[0]), 0).to(context.device),
            scene,
            MapLight.from_image(image, torch.device(context.device)),
            request.config,
            brightness=mean_radiance(image),
            seed=request.seed,
        )
        drive(context, stage)
        errors = judged(stage, transported(bundle, environment, light))
        partial = out.with_name(out.name + ".partial")
        shutil.rmtree(partial, ignore_errors=True)
        write_adapted(bundle, stage.model.cpu().eval(), light, partial, errors.figures(light.name))
        load_bundle(partial)
        partial.rename(out)
    shutil.rmtree(work, ignore_errors=True)
    reporter.log(
        "light.baked",
        name=light.name,
        steps=stage.steps_done,
        skipped=stage.num_skipped,
        adapted_error=errors.adapted,
        transport_error=errors.transport,
    )
    return light


def light_image(environment: Environment) -> Float32[ndarray, "rows columns 3"]:
    """Return an environment's radiance as it is turned, in at most `MAP_ROWS` rows."""
    radiance = environment.radiance
    if radiance.shape[0] > MAP_ROWS:
        radiance = averaged(radiance, (2 * MAP_ROWS, MAP_ROWS))
    if not environment.rotate_deg:
        return radiance
    turned = Environment(radiance, environment.rotate_deg)
    return turned.lookup(pixel_directions(*radiance.shape[:2]).astype(np.float32)).astype(np.float32)


def mean_radiance(image: Float32[ndarray, "rows columns 3"]) -> float:
    """Return the mean over all directions and channels."""
    rows, columns, _ = image.shape
    weight = pixel_solid_angles(rows, columns)[:, None, None] / (4.0 * np.pi)
    return float((image.mean(axis=-1, keepdims=True) * weight).sum())


def _opened(source: Path, run: TaskContext | None, request: BakeRequest) -> tuple[Bundle, Environment]:
    if run is not None:
        require_done(source, "export")
    try:
        bundle = load_bundle(task_folder(source, "export") if run is not None else source)
        environment = load_environment(request.environment).rotated(request.rotate_deg)
    except RelightError as error:
        raise UsageError(error.code, f"{error.message}; {error.advice}") from error
    if not bundle.has_networks:
        raise UsageError(
            "bake.networks_missing",
            f'"{source}" carries no fast cache to adapt; give a bundle of the full tier',
        )
    return bundle, environment


def _free_name(bundle: Bundle, request: BakeRequest) -> str:
    """Return the light's name in the bundle; raises `UsageError` where the bundle has one of that name."""
    name = re.sub(r"[^A-Za-z0-9_.\-]", "_", request.name or request.environment.stem)
    taken = {graph.light for graph in bundle.manifest.graphs if graph.name == "fast_cache"}
    if name in taken:
        raise UsageError(
            "bake.name_taken", f'the bundle has a fast cache for a light called "{name}"; choose a --name'
        )
    return name


def _scale_of(bundle: Bundle) -> tuple[float, float, float]:
    red, green, blue = bundle.manifest.albedo_scale_rgb
    return red, green, blue


def _context(
    run: TaskContext | None, source: Path, work: Path, request: BakeRequest, reporter: Reporter
) -> TaskContext:
    """Return a context whose task folder is the work folder's, so that a run folder is only read."""
    config = run.spec.config if run is not None else preset_of("fast")
    return TaskContext(
        spec=RunSpec(scene=source, config=config, seed=request.seed),
        run_dir=work,
        device=run.device if run is not None else "cpu",
        reporter=reporter,
        task=STAGE,
    )


def _scene(run: TaskContext | None, bundle: Bundle, light: AdaptedLight) -> BakeScene:
    ratio = torch.tensor(light.albedo_ratio, dtype=torch.float32)
    frozen = bundle_scene(bundle, ratio, num_threads=torch.get_num_threads())
    if run is None:
        return frozen
    model = load_final(run, trained_scene(run)).eval().requires_grad_(False)
    device = torch.device(run.device)
    low, high = frozen.box
    return ModelScene(
        model, frozen.viewpoints.to(device), (low.to(device), high.to(device)), ratio.to(device)
    )
