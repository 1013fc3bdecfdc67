"""Published tables are complete, add up to the published averages, and are found for the right scenes."""

import filecmp
from pathlib import Path

import numpy as np
import pytest
from lambent_run.report import published

ROOT = Path(__file__).parents[4]
DOCS = ROOT / "docs" / "benchmarks" / "published"
PACKAGE = ROOT / "worker" / "lambent_run" / "report" / "tables"


def average(rows, name):
    return float(np.mean([row.values[name] for row in rows]))


@pytest.mark.parametrize(
    ("method", "mae", "albedo", "nvs", "relight"),
    [
        ("NeRFactor", 6.314, 25.125, 24.679, 23.383),
        ("InvRender", 5.074, 27.341, 27.367, 23.973),
        ("TensoIR", 4.100, 29.275, 35.088, 28.580),
        ("Flash Cache", 3.355, 30.274, 34.908, 29.724),
    ],
)
def test_scenes_average_to_the_figures_of_the_papers_main_table(method, mae, albedo, nvs, relight):
    rows = [row for row in published.published_rows("tensoir_synthetic") if row.method == method]
    assert [row.scene for row in rows] == ["armadillo", "ficus", "hotdog", "lego"]
    found = [
        average(rows, name)
        for name in ("normal/mae_all", "albedo_rgb_ratio/psnr_gamma", "nvs/psnr", "relight_direct/psnr")
    ]
    assert found == pytest.approx([mae, albedo, nvs, relight], abs=0.0025)


@pytest.mark.parametrize(
    ("group", "method", "nvs", "relight"),
    [
        ("diffuse", "Flash Cache", 31.781, 29.679),
        ("specular", "Flash Cache", 27.180, 27.810),
        ("diffuse", "TensoIR", 32.043, 30.932),
        ("specular", "TensoIR", 27.115, 26.955),
    ],
)
def test_objects_average_to_the_figures_of_the_papers_main_table(group, method, nvs, relight):
    rows = [
        row
        for row in published.published_rows("openillumination")
        if row.group == group and row.method == method
    ]
    assert len(rows) == {"diffuse": 6, "specular": 4}[group]
    assert average(rows, "nvs/psnr") == pytest.approx(nvs, abs=0.005)
    assert average(rows, "relight_direct/psnr") == pytest.approx(relight, abs=0.005)


def test_every_ablation_has_its_three_figures_and_a_source():
    rows = published.published_rows("ablations")
    assert {row.method for row in rows} >= {"full", "k2", "k4", "k8", "depth"}
    assert all(len(row.values) == 3 and row.source for row in rows)


def test_a_scene_is_found_by_layout_and_name():
    assert {row.method for row in published.published_scene("tensoir_synthetic", "Hotdog")} >= {
        "TensoIR",
        "Flash Cache",
        "Flash Cache multi-light",
    }
    assert {row.scene for row in published.published_scene("OpenIllumination", "obj_05_bird")} == {"bird"}
    assert published.published_scene("nerf_blender", "hotdog") == []
    assert published.published_scene("tensoir_synthetic", "cowcrate") == []


def test_objects_are_told_apart_by_their_group():
    assert published.object_group("openillumination", "obj_05_bird") == "specular"
    assert published.object_group("openillumination", "obj_42_banana") == "diffuse"
    assert published.object_group("openillumination", "obj_99_spoon") == ""
    assert published.object_group("tensoir_synthetic", "lego") == ""


def test_the_documentation_holds_the_same_tables_as_the_package():
    names = sorted(path.name for path in PACKAGE.glob("*.csv"))
    assert sorted(path.name for path in DOCS.glob("*.csv")) == names
    assert len(names) == 3
    assert all(filecmp.cmp(DOCS / name, PACKAGE / name, shallow=False) for name in names)
