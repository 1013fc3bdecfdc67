"""An export step on a small model: a run folder and a scene that need no training."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from flashcache.config import EvaluationConfig, ExportConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from lambent_asset.bundle import graphs as bundle_graphs
from lambent_asset.bundle import manifest as bundle_manifest
from lambent_core.scene import Camera, Scene, View
from lambent_proto.v1.job_pb2 import Progress
from lambent_relight.cameras import look_at
from lambent_run.run.context import TaskContext
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks import export
from support.sphere_model import BOUND

SIDE = 16
LIGHTS = ("day", "a night")


class Listener:
    """A reporter that records its calls, and can request a stop."""

    def __init__(self) -> None:
        self.events: dict[str, dict] = {}
        self.artifacts: dict[str, object] = {}
        self.findings: dict[str, str] = {}
        self.fractions: list[float] = []
        self.stop = False

    def progress(self, progress: Progress) -> None:
        self.fractions.append(progress.fraction)

    def log(self, event: str, **fields: object) -> None:
        self.events[event] = fields

    def artifact(self, name: str, path: object) -> None:
        self.artifacts[name] = path

    def finding(self, code: str, message: str, *, subject: str = "", error: bool = False) -> None:
        self.findings[code] = message

    def should_stop(self) -> bool:
        return self.stop


def scene() -> Scene:
    """Return an empty capture, of which the export needs only cameras and lights."""
    views = []
    for name, position in (("test_000", (3.0, 0.0, 1.0)), ("test_001", (0.0, -3.0, 0.5))):
        camera = Camera(
            width=SIDE,
            height=SIDE,
            focal_x=20.0,
            focal_y=20.0,
            centre_x=SIDE / 2,
            centre_y=SIDE / 2,
            camera_to_world=look_at(position, (0.0, 0.0, 0.0)),
        )
        images = {light: np.zeros((SIDE, SIDE, 4), np.float32) for light in LIGHTS}
        views.append(View(name=name, camera=camera, images=images))
    return Scene(
        name="ball",
        lights=LIGHTS,
        train=tuple(views),
        test=tuple(views),
        bounds_min=(-BOUND,) * 3,
        bounds_max=(BOUND,) * 3,
        primary=(2.0, 5.0),
        secondary=(0.05, 2.0),
        contraction_radius=1.0,
    )


def finer(view: View) -> View:
    """Return the photograph of `view` at twice its size."""
    images = {light: np.repeat(np.repeat(image, 2, 0), 2, 1) for light, image in view.images.items()}
    return replace(view, camera=view.camera.resized(2 * SIDE, 2 * SIDE), images=images)


def small_context(tmp_path: Path, model: InverseModel, monkeypatch: pytest.MonkeyPatch) -> TaskContext:
    """Return a context whose run has `model` as its trained model, and whose bundle takes seconds."""
    monkeypatch.setattr(export, "read_scene", lambda context: scene())
    monkeypatch.setattr(export, "load_final", lambda context, scene: model)
    views = [finer(view) for view in scene().train]
    monkeypatch.setattr(
        export, "photographs_of", lambda context, light: ([view.camera for view in views], lambda: views)
    )
    monkeypatch.setattr(bundle_graphs, "PARITY_ROWS", 256)
    # A commit between two exports of a test would change the producer in every graph.
    monkeypatch.setattr(bundle_manifest, "git_revision", lambda: "0" * 40)
    (tmp_path / "scene").mkdir()
    config = replace(
        tiny(),
        evaluation=EvaluationConfig(uncertainty_points=60),
        export=ExportConfig(
            gbuffer_samples=32,
            mesh_resolution=24,
            max_faces=600,
            atlas_size=128,
            transport_size=64,
            occlusion_points=200,
            occlusion_rays=4,
            environment_height=8,
        ),
    )
    made = TaskContext(
        spec=RunSpec(scene=tmp_path / "scene", config=config),
        run_dir=tmp_path / "run",
        device="cpu",
        reporter=Listener(),
        task="export",
    )
    made.folder.mkdir(parents=True)
    (made.run_dir / "previews").mkdir()
    for name in ("cache.png", "evaluation.png", "turning_cache.png"):
        (made.run_dir / "previews" / name).write_bytes(b"\x89PNG")
    return made
