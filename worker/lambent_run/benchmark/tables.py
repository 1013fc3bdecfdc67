"""The tables of a benchmark: the paper's layout, with our metrics and errors next to the published ones."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from lambent_run.benchmark.results import Row, Value
from lambent_run.report import protocol
from lambent_run.report.published import (
    PublishedRow,
    dataset_of,
    published_rows,
    published_scene,
)

SCENE_COLUMNS = (
    ("Normal MAE ↓", "normal/mae_all"),
    ("on object ↓", "normal/mae_mask"),
    ("Albedo PSNR ↑", "albedo_rgb_ratio/psnr_gamma"),
    ("SSIM ↑", "albedo_rgb_ratio/ssim"),
    ("LPIPS ↓", "albedo_rgb_ratio/lpips"),
    ("NVS PSNR ↑", "nvs/psnr"),
    ("SSIM ↑", "nvs/ssim"),
    ("LPIPS ↓", "nvs/lpips"),
    ("Relit PSNR ↑", "relight_direct/psnr"),
    ("SSIM ↑", "relight_direct/ssim"),
    ("LPIPS ↓", "relight_direct/lpips"),
    ("one bounce PSNR ↑", "relight/psnr"),
)
"""Of the supplement's table 2, with two more of ours."""
ABLATION_COLUMNS = (
    ("NVS PSNR ↑", "nvs/psnr"),
    ("Albedo PSNR ↑", "albedo_rgb_ratio/psnr_gamma"),
    ("Normal MAE ↓", "normal/mae_all"),
    ("Relit PSNR ↑", "relight_direct/psnr"),
)
"""Of the supplement's table 1, with relighting."""
OBJECT_COLUMNS = (("NVS PSNR ↑", "nvs/psnr"), ("Relit PSNR ↑", "relight_direct/psnr"))
"""Of the supplement's table 3."""
LPIPS_NETS = ("vgg", "alex")
NOTHING = "–"


@dataclass(frozen=True, kw_only=True, slots=True)
class Content:
    """Contents of the tables."""

    preset: str
    rows: Sequence[Row]
    averages: Sequence[Row]
    differences: Mapping[str, Mapping[str, Value]]
    failed: Sequence[str] = ()
    notes: Sequence[str] = field(default_factory=tuple)


def markdown(content: Content) -> str:
    """Return the tables as Markdown."""
    objects = [row for row in content.rows if dataset_of(row.layout) == "openillumination"]
    scenes = [row for row in content.rows if row not in objects]
    parts = [f"# Benchmark, preset {content.preset}", _legend(content)]
    parts += [_scene_table(title, part) for title, part in _by_scene(scenes)]
    averages = [row for row in content.averages if dataset_of(row.layout) != "openillumination"]
    for layout in dict.fromkeys(row.layout for row in averages):
        members = [row for row in averages if row.layout == layout]
        parts.append(_scene_table(f"Mean over scenes, {layout}", members))
    if objects:
        parts.append(_object_table(objects, content.averages))
    parts += [_ablation_table(content), _published()]
    if content.failed:
        parts.append("## Failed\n\n" + "\n".join(f"- {line}" for line in content.failed))
    rules = "\n".join(f"- {rule}" for rule in protocol.SUMMARY)
    parts.append(f"## Protocol {protocol.VERSION}, in short\n\n{rules}")
    return "\n\n".join(part for part in parts if part) + "\n"


def _legend(content: Content) -> str:
    over = {value.over for row in content.rows for value in row.values.values()}
    lines = [
        "The number after ± is the standard error over " + " or ".join(sorted(over) or ["nothing"]) + "."
    ]
    if "views" in over:
        lines.append("Over views it does not know how another seed would have ended: give several --seeds.")
    return "\n".join(f"- {line}" for line in (*lines, *content.notes))


def _by_scene(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    names = dict.fromkeys(row.scene for row in rows)
    return [(name, [row for row in rows if row.scene == name]) for name in names]


def _scene_table(title: str, rows: Sequence[Row]) -> str:
    lines = [
        [_method(row), str(row.num_runs), *(_shown(find(row.values, name)) for _, name in SCENE_COLUMNS)]
        for row in rows
    ]
    lines += [
        [published.method, "", *_published_cells(published, SCENE_COLUMNS)]
        for published in published_scene(rows[0].layout, rows[0].scene)
    ]
    head = ["method", "runs", *(title for title, _ in SCENE_COLUMNS)]
    return f"## {title}\n\n{_table(head, lines)}"


def _object_table(rows: Sequence[Row], averages: Sequence[Row]) -> str:
    """Return OpenIllumination's table: novel views from one light, relighting from several, groups apart."""
    lines = []
    merged = [*rows, *(row for row in averages if dataset_of(row.layout) == "openillumination")]
    for group in ("diffuse", "specular", ""):
        members = [row for row in merged if row.group == group]
        for scene in dict.fromkeys(row.scene for row in members):
            of_scene = [row for row in members if row.scene == scene]
            for published in published_scene(rows[0].layout, scene):
                cells = _published_cells(published, OBJECT_COLUMNS)
                lines.append([group or "other", scene, published.method, *cells])
            for ablation in dict.fromkeys(row.ablation for row in of_scene):
                values: dict[str, Value] = {}
                for row in of_scene:
                    if row.ablation == ablation:
                        values |= row.values
                cells = [_shown(find(values, name)) for _, name in OBJECT_COLUMNS]
                lines.append([group or "other", scene or "mean", f"ours, {ablation}", *cells])
    head = ["group", "object", "method", *(title for title, _ in OBJECT_COLUMNS)]
    return f"## OpenIllumination\n\n{_table(head, lines)}"


def _ablation_table(content: Content) -> str:
    """Return ablations with their difference from the full method, next to the paper's figures."""
    paper = {row.method: row for row in published_rows("ablations")}
    rows = content.averages or content.rows
    settings = dict.fromkeys((row.layout, row.scene, row.group, row.setting) for row in rows)
    parts = []
    for key in settings:
        lines = []
        for row in (row for row in rows if (row.layout, row.scene, row.group, row.setting) == key):
            change = content.differences.get(row.ablation, {})
            cells = [row.label]
            for _, name in ABLATION_COLUMNS:
                cells += [_shown(find(row.values, name)), _shown(change.get(name), signed=True)]
            known = paper.get(row.ablation)
            cells += _published_cells(known, ABLATION_COLUMNS[:3]) if known else [NOTHING] * 3
            lines.append(cells)
        head = ["method"]
        for title, _ in ABLATION_COLUMNS:
            head += [title, "Δ"]
        head += [f"paper: {title}" for title, _ in ABLATION_COLUMNS[:3]]
        layout, scene, group, setting = key
        name = ", ".join(part for part in (scene or f"mean over {layout}", group, f"{setting} light") if part)
        parts.append(f"### {name}\n\n{_table(head, lines)}")
    text = (
        "Δ is the mean difference to the full method over pairs that share scene, seed and stage one (all "
        "scenes of the suite), ± its standard error over pairs. The paper's figures are averages over "
        "TensoIR-synthetic: compare signs, not values."
    )
    return "\n\n".join(["## Ablations", text, *parts])


def _published() -> str:
    """Return the tables of the supplement, independent of the suite."""
    first = [
        [row.method, row.source, *_published_cells(row, ABLATION_COLUMNS[:3])]
        for row in published_rows("ablations")
    ]
    columns = [column for column in SCENE_COLUMNS if column[1] not in ("normal/mae_mask", "relight/psnr")]
    second = [
        [row.scene, row.method, *_published_cells(row, columns)]
        for row in published_rows("tensoir_synthetic")
    ]
    third = [
        [row.group, row.scene, row.method, *_published_cells(row, OBJECT_COLUMNS)]
        for row in published_rows("openillumination")
    ]
    return "\n\n".join(
        [
            "## Published figures",
            "Ablations, averages over TensoIR-synthetic:",
            _table(["ablation", "source", *(title for title, _ in ABLATION_COLUMNS[:3])], first),
            "TensoIR-synthetic (supplement, table 2; relighting with direct light only):",
            _table(["scene", "method", *(title for title, _ in columns)], second),
            "OpenIllumination (supplement, table 3):",
            _table(["group", "object", "method", *(title for title, _ in OBJECT_COLUMNS)], third),
        ]
    )


def find(values: Mapping[str, Value], name: str) -> Value | None:
    """Return a figure by name; `.../lpips` stands for whichever network there is."""
    if not name.endswith("/lpips"):
        return values.get(name)
    return next((values[f"{name}_{net}"] for net in LPIPS_NETS if f"{name}_{net}" in values), None)


def _published_cells(row: PublishedRow, columns: Sequence[tuple[str, str]]) -> list[str]:
    cells = []
    for _, name in columns:
        value = row.values.get(f"{name}_vgg" if name.endswith("/lpips") else name)
        cells.append(NOTHING if value is None else f"{value:.3f}")
    return cells


def _shown(value: Value | None, *, signed: bool = False) -> str:
    if value is None:
        return NOTHING
    number = f"{value.mean:+.3f}" if signed else f"{value.mean:.3f}"
    return number if value.standard_error is None else f"{number} ± {value.standard_error:.3f}"


def _method(row: Row) -> str:
    return row.label if row.setting == "single" else f"{row.label}, several lights"


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in rows)


def as_csv(content: Content) -> str:
    """Return every figure as one line of CSV, with where it belongs and what its error is over."""
    head = "scene,group,layout,lights,ablation,figure,mean,standard_error,over,count"
    lines = [
        [row.scene or "mean", row.group, row.layout, row.setting, row.ablation, name, *_plain(value)]
        for row in (*content.rows, *content.averages)
        for name, value in row.values.items()
    ]
    lines += [
        ["difference to full", "", "", "", ablation, name, *_plain(value)]
        for ablation, figures in content.differences.items()
        for name, value in figures.items()
    ]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head.split(","), *lines])
    return text.getvalue()


def _plain(value: Value) -> list[Any]:
    error = "" if value.standard_error is None else f"{value.standard_error:.6g}"
    return [f"{value.mean:.6g}", error, value.over, value.count]


def as_json(content: Content) -> str:
    """Return everything as JSON, the published figures included."""

    def row(item: Row) -> dict[str, Any]:
        record = asdict(item)
        return record | {"lights": record.pop("setting"), "figures": record.pop("values")}

    def published(item: PublishedRow) -> dict[str, Any]:
        record = asdict(item)
        return record | {"figures": record.pop("values")}

    tables = ("ablations", "tensoir_synthetic", "openillumination")
    record = {
        "schema_version": "1.0",
        "protocol_version": protocol.VERSION,
        "protocol": list(protocol.SUMMARY),
        "preset": content.preset,
        "scenes": [row(item) for item in content.rows],
        "means": [row(item) for item in content.averages],
        "differences_to_full": {
            ablation: {name: asdict(item) for name, item in figures.items()}
            for ablation, figures in content.differences.items()
        },
        "failed": list(content.failed),
        "notes": list(content.notes),
        "published": {table: [published(item) for item in published_rows(table)] for table in tables},
    }
    return json.dumps(record, indent=1) + "\n"
