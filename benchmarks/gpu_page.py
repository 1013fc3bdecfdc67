"""The page of what was measured on a GPU, from the records of its pieces."""

import math
from collections.abc import Mapping
from typing import Any

from benchmarks.gpu_timing import Spread

Records = Mapping[str, dict[str, Any]]


def page(records: Records, command: str) -> str:
    """Return the page in Markdown: a section for each record, in their order."""
    on_gpu = all("gpu" in record["machine"] for record in records.values())
    title = "Measured on a GPU" if on_gpu else "On a processor, to test the program: nothing here is of a GPU"
    parts = [f"# {title}", "", f"    {command}", ""]
    parts.append(
        "Written by the program from the records of its pieces. Times are medians with the least and the "
        "largest of the repeats, between events on a GPU."
    )
    for name, record in records.items():
        about = ", ".join(f"{key} {value}" for key, value in record["machine"].items())
        parts += ["", f"## {name}", f"{about}; {record['seconds']:.0f} s.", ""]
        parts += SECTIONS[record["kind"]](record["result"])
    return "\n".join(parts) + "\n"


def table(head: list[str], rows: list[list[str]]) -> list[str]:
    """Return the lines of a table."""
    return [f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)]


def shown(times: Spread) -> str:
    """Return median and range in milliseconds."""
    return f"{times['median']:.3g} ({times['least']:.3g} to {times['largest']:.3g})"


def tests_section(result: dict[str, Any]) -> list[str]:
    """Return the outcome of the tests, and how they failed."""
    outcome = "passed" if result["code"] == 0 else f"**failed with status {result['code']}**"
    return [f"`{result['command']}`: {outcome}; {result['summary']}", "", "```", result["tail"], "```"]


def kernels_section(result: dict[str, Any]) -> list[str]:
    """Return the table of operations."""
    rows = []
    for row in result["rows"]:
        kernel, plain = row["kernel"], row["plain"]
        share = row["limit_ms"] / kernel["median"]
        rows.append(
            [
                row["name"],
                shown(kernel),
                shown(plain),
                f"{plain['median'] / kernel['median']:.1f}",
                f"{row['bytes'] / 2**20:.0f}",
                f"{row['limit_ms']:.3g}",
                f"{100 * share:.0f} %",
                f"{row['row_bytes'] / 1e6 / kernel['median']:.0f}" if row["row_bytes"] else "",
            ]
        )
    head = ["operation", "kernel [ms]", "plain torch [ms]", "ratio", "MiB", "limit [ms]", "of the limit"]
    return [
        f"Copying moves {result['bytes_per_s'] / 1e9:.0f} GB/s here. The limit is the time in which that "
        "moves every argument and result once, and of a table no more than all of it; rows count each row as "
        "often as it is read or added to. The cache is empty before each repeat. Sizes are "
        f"1/{result['share']} of the paper's.",
        "",
        *table([*head, "rows [GB/s]"], rows),
    ]


def steps_section(result: dict[str, Any]) -> list[str]:
    """Return the tables of steps and of their kernels."""
    rows, profiles = [], []
    for stage in ("one", "two"):
        for way, found in result[stage].items():
            profile = found["profile"]
            rows.append(
                [
                    stage,
                    str(found["rays"]),
                    way,
                    shown(found["times"]),
                    f"{profile['busy_ms']:.1f}",
                    f"{profile['calls']:.0f}",
                    f"{found['peak_bytes'] / 2**30:.2f}",
                    str(found["skipped"]),
                ]
            )
            if found["problem"] is not None:
                profiles += ["", f"Stage {stage} gave its graphs up: {found['problem']}"]
            if way == "eager":
                largest = [
                    [f"`{each['name']}`", f"{each['ms']:.2f}", f"{each['calls']:.0f}"]
                    for each in profile["largest"]
                ]
                profiles += [
                    "",
                    f"Stage {stage}, the largest:",
                    "",
                    *table(["kernel", "ms", "calls"], largest),
                ]
    head = ["stage", "rays", "steps", "step [ms]", "busy [ms]", "launches", "peak [GiB]", "skipped"]
    return [
        f"Preset `{result['preset']}`, 1/{result['share']} of its batch, after "
        f"{100 * result['progress']:.0f} % of the schedule. Busy is the time in kernels, from a profile of "
        "other steps. `graphs` and `eager` steps have fixed shapes, and the host never waits for them; with "
        "`picked rows` it does. All but `plain torch` use the kernels.",
        "",
        *table(head, rows),
        *profiles,
    ]


def rays_section(result: dict[str, Any]) -> list[str]:
    """Return seconds per million secondary rays beside the paper's."""
    rows = []
    for cache in ("fast cache", "NeRF cache"):
        found = result[cache]
        per_million = []
        for what in ("forward", "with gradient"):
            # Milliseconds per ray are thousands of seconds per million.
            least, median, largest = (
                1e3 * found[what][which] / found["rays"] for which in ("least", "median", "largest")
            )
            per_million.append(f"{median:.3g} ({least:.3g} to {largest:.3g})")
        rows.append([cache, str(found["rays"]), *per_million, f"{found['paper_s']}"])
    head = ["cache", "rays at once", "forward [s/M]", "with gradient [s/M]", "paper, A100 [s/M]"]
    return [f"Preset `{result['preset']}`, seconds per million rays.", "", *table(head, rows)]


def training_section(result: dict[str, Any]) -> list[str]:
    """Return the curve, the time of each task, and the figures once it is finished."""
    seconds = ", ".join(f"{task} {value:.0f} s" for task, value in result["seconds"].items())
    state = "finished" if result["finished"] else "not finished"
    steps = " and ".join(f"{count} ({stage})" for stage, count in result["steps"].items())
    lines = [f"Preset `{result['preset']}` on {result['scene']}, {steps} steps: {state}. {seconds}.", ""]
    marks = [
        [
            one["stage"],
            str(one["step"]),
            f"{one['seconds']:.0f}",
            f"{one['psnr']:.2f}",
            "" if math.isnan(one["normals"]) else f"{one['normals']:.1f}",
        ]
        for one in result["marks"]
    ]
    head = ["stage", "step", "training of the stage [s]", "cache [dB]", "normals [deg]"]
    lines += table(head, marks) if marks else ["No checkpoint was kept yet."]
    if result["figures"]:
        figures = [[name, f"{value:.2f}"] for name, value in result["figures"].items()]
        lines += ["", *table(["figure", "value"], figures)]
    return lines


SECTIONS = {
    "tests": tests_section,
    "kernels": kernels_section,
    "steps": steps_section,
    "rays": rays_section,
    "training": training_section,
}
