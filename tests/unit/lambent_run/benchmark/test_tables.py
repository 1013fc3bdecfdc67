"""The tables show our figures with errors, and the published ones beside them whatever the suite holds."""

import csv
import io
import json

import pytest
from lambent_run.benchmark.results import Row, Value
from lambent_run.benchmark.tables import Content, as_csv, as_json, markdown


def row(scene="crate", ablation="full", layout="tensoir_synthetic", setting="single", group="", **figures):
    values = {
        name.replace("__", "/"): Value(mean, error, "seeds", 3) for name, (mean, error) in figures.items()
    }
    return Row(scene, group, layout, setting, ablation, f"label of {ablation}", 3, values)


FULL = row(
    nvs__psnr=(31.25, 0.125),
    relight_direct__psnr=(26.5, None),
    albedo_rgb_ratio__lpips_alex=(0.0625, 0.001),
    normal__mae_all=(3.5, 0.25),
)
DEPTH = row(ablation="depth", nvs__psnr=(30.0, 0.1))


def content(*rows, **changes):
    given = {"preset": "fast", "rows": rows or (FULL, DEPTH), "averages": (), "differences": {}}
    return Content(**{**given, **changes})


def line_of(text: str, start: str, after: str = "") -> list[str]:
    """Return the cells of the first table line that begins with `start`, after a text."""
    rest = text[text.index(after) :]
    line = next(line for line in rest.splitlines() if line.startswith(f"| {start} |"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_scene_has_the_papers_columns_with_errors():
    cells = line_of(markdown(content()), "label of full", "## crate")
    assert cells[:8] == [
        *("label of full", "3", "3.500 ± 0.250", "–", "–", "–", "0.062 ± 0.001", "31.250 ± 0.125"),
    ]
    assert cells[10] == "26.500"


def test_a_published_scene_has_the_published_rows_below_ours():
    text = markdown(content(row(scene="hotdog", nvs__psnr=(35.0, 0.1))))
    part = text[text.index("## hotdog") : text.index("## Ablations")]
    assert line_of(part, "Flash Cache")[7] == "36.966"
    assert line_of(part, "TensoIR")[4] == "30.370"
    assert part.index("label of full") < part.index("| TensoIR |")


def test_a_scene_that_nobody_published_has_none():
    part = markdown(content())
    assert "TensoIR" not in part[part.index("## crate") : part.index("## Ablations")]


def test_ablations_show_differences_and_the_papers_figures():
    change = {"depth": {"nvs/psnr": Value(-1.25, 0.2, "scenes and seeds", 6)}}
    text = markdown(content(differences=change))
    cells = line_of(text, "label of depth", "## Ablations")
    assert cells[1:3] == ["30.000 ± 0.100", "-1.250 ± 0.200"]
    assert cells[-3:] == ["34.249", "29.838", "3.491"]
    assert line_of(text, "label of full", "## Ablations")[-3:] == ["34.915", "30.345", "3.355"]


def test_all_published_tables_are_printed_whatever_the_suite_holds():
    text = markdown(content())
    part = text[text.index("## Published figures") :]
    assert part.count("| Flash Cache |") == 14
    assert part.count("| TensoIR |") == 14
    assert "| diffuse | banana | TensoIR | 34.770 | 32.130 |" in part
    assert "supplement table 1 (d)" in part


def test_openillumination_takes_novel_views_from_one_light_and_relighting_from_several():
    single = row(scene="obj_05_bird", layout="openillumination", group="specular", nvs__psnr=(29.0, 0.1))
    several = row(
        scene="obj_05_bird",
        layout="openillumination",
        group="specular",
        setting="multi",
        relight_direct__psnr=(28.0, 0.2),
        nvs_several_lights__psnr=(10.0, 0.1),
    )
    text = markdown(content(single, several))
    part = text[text.index("## OpenIllumination") : text.index("## Ablations")]
    assert "| specular | obj_05_bird | ours, full | 29.000 ± 0.100 | 28.000 ± 0.200 |" in part
    assert "| specular | obj_05_bird | Flash Cache | 29.920 | 30.190 |" in part
    assert "10.000" not in part


def test_the_protocol_and_its_version_are_part_of_the_tables():
    text = markdown(content())
    assert "## Protocol 1." in text
    assert "median of truth / prediction" in text


def test_failures_and_notes_are_named():
    text = markdown(content(failed=("crate, seed 0: see log.txt",), notes=("Not relit.",)))
    assert "- crate, seed 0: see log.txt" in text
    assert "Not relit." in text


def test_the_csv_has_a_line_for_every_figure():
    change = {"depth": {"nvs/psnr": Value(-1.25, None, "scenes and seeds", 1)}}
    lines = list(csv.DictReader(io.StringIO(as_csv(content(differences=change)))))
    assert len(lines) == 6
    first = lines[0]
    assert (first["scene"], first["ablation"], first["figure"]) == ("crate", "full", "nvs/psnr")
    assert float(first["mean"]) == 31.25
    assert float(first["standard_error"]) == 0.125
    assert lines[-1]["scene"] == "difference to full"
    assert lines[-1]["standard_error"] == ""


def test_the_json_holds_everything_and_the_published_tables():
    record = json.loads(as_json(content(failed=("x",))))
    assert record["scenes"][0]["figures"]["nvs/psnr"]["mean"] == 31.25
    assert record["failed"] == ["x"]
    assert {name: len(rows) for name, rows in record["published"].items()} == {
        "ablations": 7,
        "tensoir_synthetic": 24,
        "openillumination": 20,
    }
    assert record["protocol"]


@pytest.mark.parametrize("write", [markdown, as_csv, as_json])
def test_a_benchmark_without_any_result_still_has_tables(write):
    assert write(Content(preset="fast", rows=(), averages=(), differences={}))
