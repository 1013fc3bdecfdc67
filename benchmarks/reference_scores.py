"""Figures of `tests/references/evaluate.py`, the metric script that shares no code with the product."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

REFERENCE = Path(__file__).parent.parent / "tests" / "references" / "evaluate.py"


def reference_report(scene: Path, predictions: Path, views: int = 0) -> dict[str, Any]:
    """Return the report of the reference evaluation over `views` test views, 0 for all.

    What the script does not find in `predictions` has no row.
    """
    command = [sys.executable, str(REFERENCE), str(scene), str(predictions), "--max-views", str(views)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def reference_scores(scene: Path, predictions: Path, views: int = 0) -> dict[str, float]:
    """Return the rows of `reference_report` that are numbers."""
    report = reference_report(scene, predictions, views)
    return {key: float(value) for key, value in report.items() if isinstance(value, int | float)}


FIGURES = {
    "cache novel views [dB]": ("pred_cache", "nvs/psnr"),
    "novel views [dB]": ("pred", "nvs/psnr"),
    "albedo [dB]": ("pred", "albedo_rgb_ratio/psnr_gamma"),
    "albedo, interior [dB]": ("pred", "albedo_interior/psnr_gamma"),
    "normals, inside mask [deg]": ("pred", "normal/mae_mask"),
    "relit, direct only [dB]": ("pred_direct", "relight/psnr"),
    "relit [dB]": ("pred", "relight/psnr"),
    "relit [SSIM]": ("pred", "relight/ssim"),
    "perceptual roughness [rmse]": ("pred", "roughness/rmse"),
    "metalness [rmse]": ("pred", "metallic/rmse"),
}
"""Figures that pages quote: the folder of `lambent evaluate` they come from, and the script's name."""


def figures_of(scene: Path, report: Path, views: int = 0) -> dict[str, float]:
    """Return `FIGURES` of the predictions that `lambent evaluate` wrote to `report`, as far as they exist."""
    folders = {folder for folder, _ in FIGURES.values() if (report / folder).is_dir()}
    scores = {folder: reference_scores(scene, report / folder, views) for folder in folders}
    return {
        name: scores[folder][key] for name, (folder, key) in FIGURES.items() if key in scores.get(folder, {})
    }
