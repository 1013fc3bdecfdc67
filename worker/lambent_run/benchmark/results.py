"""Metrics of a benchmark's cells, combined over seeds and scenes with their errors."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from lambent_core.files import read_record

from lambent_run.benchmark.cell import RESULT
from lambent_run.benchmark.plan import FULL, Cell

SEEDS, VIEWS, SCENES = "seeds", "views", "scenes and seeds"


@dataclass(frozen=True, slots=True)
class Value:
    """A mean with its standard error."""

    mean: float
    standard_error: float | None
    """None if it cannot be estimated."""
    over: str
    """The samples of the standard error: "seeds", "views", or "scenes and seeds"."""
    count: int


@dataclass(frozen=True, slots=True)
class Row:
    """One scene (or group of scenes), one number of lights, one ablation."""

    scene: str
    """Empty for a mean over scenes."""
    group: str
    layout: str
    setting: str
    ablation: str
    label: str
    num_runs: int
    values: dict[str, Value]
    """By name of the figure."""


Metrics = dict[str, tuple[float, float]]
"""Value and standard error over views, by name of the figure."""


def finished(cells: Iterable[Cell], out: Path) -> list[tuple[Cell, Metrics]]:
    """Return the finished cells with their metrics."""
    results = []
    for cell in cells:
        record = read_record(out / "cells" / cell.name / RESULT)
        if record.get("inputs") == cell.inputs:
            rows = record["report"]["metrics"]
            values = {row["name"]: (float(row["value"]), float(row["standard_error"])) for row in rows}
            results.append((cell, values))
    return results


def scene_rows(results: Sequence[tuple[Cell, Metrics]]) -> list[Row]:
    """Return one row per scene, setting and ablation: means over seeds.

    With one seed the standard error is the report's own, over views: it does not include the variation
    between seeds.
    """
    keys = list(dict.fromkeys((cell.scene, cell.setting, cell.ablation) for cell, _ in results))
    rows = []
    for key in keys:
        members = [(c, m) for c, m in results if (c.scene, c.setting, c.ablation) == key]
        cell = members[0][0]
        names = list(dict.fromkeys(name for _, metrics in members for name in metrics))
        values = {name: _over_seeds([m[name] for _, m in members if name in m]) for name in names}
        rows.append(
            Row(
                cell.scene,
                cell.group,
                cell.layout,
                cell.setting,
                cell.ablation,
                cell.label,
                len(members),
                values,
            )
        )
    return rows


def _over_seeds(runs: Sequence[tuple[float, float]]) -> Value:
    numbers = np.array([value for value, _ in runs])
    if len(runs) == 1:
        return Value(float(numbers[0]), runs[0][1] or None, VIEWS, 1)
    return Value(float(numbers.mean()), _standard_error(numbers), SEEDS, len(runs))


def average_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the mean over scenes of each setting and ablation, for groups of scenes apart.

    Only where every ablation has the same scenes; otherwise a mean would compare scenes instead. The standard
    error combines those of the scenes and says nothing about other scenes.
    """
    keys = list(dict.fromkeys((row.layout, row.group, row.setting) for row in rows))
    averages = []
    for layout, group, setting in keys:
        members = [row for row in rows if (row.layout, row.group, row.setting) == (layout, group, setting)]
        by_ablation = {
            name: [row for row in members if row.ablation == name]
            for name in dict.fromkeys(row.ablation for row in members)
        }
        scenes = {tuple(sorted(row.scene for row in part)) for part in by_ablation.values()}
        if len(scenes) > 1 or len(next(iter(scenes))) < 2:
            continue
        for name, part in by_ablation.items():
            shared = [key for key in part[0].values if all(key in row.values for row in part)]
            values = {key: _over_scenes([row.values[key] for row in part]) for key in shared}
            runs = sum(row.num_runs for row in part)
            averages.append(Row("", group, layout, setting, name, part[0].label, runs, values))
    return averages


def _over_scenes(values: Sequence[Value]) -> Value:
    mean = float(np.mean([value.mean for value in values]))
    errors = [value.standard_error for value in values]
    known = [error for error in errors if error is not None]
    error = float(np.sqrt(np.sum(np.square(known))) / len(values)) if len(known) == len(values) else None
    return Value(mean, error, values[0].over, len(values))


def differences(results: Sequence[tuple[Cell, Metrics]], names: Sequence[str]) -> dict[str, dict[str, Value]]:
    """Return by ablation and figure the mean difference to the full method, over the same scenes and seeds.

    Pairs share scene, lights, seed and stage one, so that their effect cancels; the standard error
    is over pairs, None for a single one.
    """
    full = {(c.scene, c.setting, c.seed): m for c, m in results if c.ablation == FULL}
    gains: dict[str, dict[str, list[float]]] = {}
    for cell, metrics in results:
        other = full.get((cell.scene, cell.setting, cell.seed))
        if cell.ablation == FULL or other is None:
            continue
        for name in names:
            if name in metrics and name in other:
                gained = metrics[name][0] - other[name][0]
                gains.setdefault(cell.ablation, {}).setdefault(name, []).append(gained)
    return {
        ablation: {name: _of_pairs(np.array(values)) for name, values in figures.items()}
        for ablation, figures in gains.items()
    }


def _of_pairs(values: np.ndarray) -> Value:
    error = _standard_error(values) if len(values) > 1 else None
    return Value(float(values.mean()), error, SCENES, len(values))


def _standard_error(values: np.ndarray) -> float:
    return float(values.std(ddof=1) / np.sqrt(len(values)))
