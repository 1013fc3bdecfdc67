"""Subjects of evaluations whose model is only looked at."""

from pathlib import Path
from typing import Any

from lambent_core.scene import Scene
from lambent_run.report.request import EvaluationRequest, Subject


def subject_of(model: Any, scene: Scene, **changes: Any) -> Subject:
    """Return the evaluation of a model on the test views of a scene, with `changes`."""
    given = {"views": scene.test, "held_out": True, "maps": {}, "request": EvaluationRequest(), "seed": 0}
    given |= {"out": Path(), "advance": lambda: None}
    return Subject(model=model, scene=scene, **{**given, **changes})
