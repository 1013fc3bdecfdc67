"""Published figures for comparison with ours: tables 1 to 3 of the paper's supplement.

The files lie in `tables/`; docs/benchmarks/published/README.md says where each comes from.
"""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

METRICS = {
    "normal_mae": "normal/mae_all",
    "albedo_psnr": "albedo_rgb_ratio/psnr_gamma",
    "albedo_ssim": "albedo_rgb_ratio/ssim",
    "albedo_lpips": "albedo_rgb_ratio/lpips_vgg",
    "nvs_psnr": "nvs/psnr",
    "nvs_ssim": "nvs/ssim",
    "nvs_lpips": "nvs/lpips_vgg",
    "relight_psnr": "relight_direct/psnr",
    "relight_ssim": "relight_direct/ssim",
    "relight_lpips": "relight_direct/lpips_vgg",
}
"""Our figure for each column; the paper relights with direct light only."""
DATASETS = ("tensoir_synthetic", "openillumination")
"""Layouts whose scenes have published figures."""


@dataclass(frozen=True, slots=True)
class PublishedRow:
    """One line of a published table."""

    scene: str
    """Lower case; empty for an average over scenes."""
    method: str
    """A method's name, or that of an ablation of ours."""
    values: Mapping[str, float]
    """By our names of figures."""
    group: str = ""
    """"diffuse" or "specular" in OpenIllumination."""
    source: str = ""


def published_rows(table: str) -> list[PublishedRow]:
    """Return the lines of `tables/<table>.csv`, in the order of the publication."""
    text = resources.files("lambent_run.report").joinpath("tables", f"{table}.csv").read_text("utf-8")
    return [
        PublishedRow(
            scene=line.get("scene", ""),
            method=line.get("method") or line["ablation"],
            values={METRICS[name]: float(value) for name, value in line.items() if name in METRICS},
            group=line.get("group", ""),
            source=line.get("source", ""),
        )
        for line in csv.DictReader(text.splitlines())
    ]


def dataset_of(layout: str) -> str:
    """Return the data set with published figures that a layout belongs to, or "" for none."""
    plain = re.sub(r"[^a-z]", "", layout.lower())
    return next((name for name in DATASETS if name.replace("_", "") == plain), "")


def published_scene(layout: str, scene: str) -> list[PublishedRow]:
    """Return the published results for a scene, by layout and name; empty if there are none.

    A name matches by one of its words: `obj_05_bird` is `bird`. The layout must match too, since other data
    sets have scenes of the same name.
    """
    dataset = dataset_of(layout)
    words = set(re.findall(r"[a-z]+", scene.lower()))
    return [row for row in published_rows(dataset) if row.scene in words] if dataset else []


def object_group(layout: str, scene: str) -> str:
    """Return "diffuse" or "specular" for an object of OpenIllumination's published list, else ""."""
    return next((row.group for row in published_scene(layout, scene)), "")
