"""Cells and results of an imaginary benchmark."""

from dataclasses import replace
from pathlib import Path

from lambent_core.files import write_json
from lambent_run.benchmark.cell import RESULT
from lambent_run.benchmark.plan import Cell
from lambent_run.report.request import EvaluationRequest

CELL = Cell(
    scene="crate",
    scene_dir="/nowhere/crate",
    layout="tensoir_synthetic",
    group="",
    setting="single",
    lights=("sun",),
    seed=0,
    ablation="full",
    label="full method",
    preset="tiny",
    base_overrides={},
    overrides={},
    evaluation=EvaluationRequest(),
    stage_one="a" * 64,
    inputs="b" * 64,
)


def cell(scene: str = "crate", ablation: str = "full", seed: int = 0, **changes: object) -> Cell:
    """Return a cell whose inputs are named after it, with one stage one per scene and seed."""
    named = replace(
        CELL,
        scene=scene,
        ablation=ablation,
        seed=seed,
        label=f"label of {ablation}",
        stage_one=f"{scene}{seed}stage".ljust(64, "0"),
        inputs=f"{scene}{seed}{ablation}".ljust(64, "0"),
    )
    return replace(named, **changes)


def write_result(out: Path, of: Cell, **figures: tuple[float, float]) -> None:
    """Write a cell's result with figures given as value and standard error over views, `__` for `/`."""
    folder = out / "cells" / of.name
    folder.mkdir(parents=True)
    metrics = [
        {"name": name.replace("__", "/"), "value": value, "standard_error": error, "unit": "dB"}
        for name, (value, error) in figures.items()
    ]
    write_json(folder / RESULT, {"inputs": of.inputs, "report": {"metrics": metrics}})
