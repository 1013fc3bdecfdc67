"""Whether several lights help: one light, the same light turned three ways, and three lights learned apart.

    python benchmarks/lights.py SUITE/cowcrate --environments SUITE/envmaps/high_res --seeds 0 1 2 -o OUT

Each run is `lambent train` and `lambent evaluate`, scored by `tests/references/evaluate.py`. All runs take
the same number of steps and rays, so that with three lights every light gets a third of them. Novel views
are compared under the first light, which all runs have seen; relit pictures under lights that none has.
Results are kept in OUT/<setting>_<seed>/; a run that is there is not repeated.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from reference_scores import figures_of, reference_scores

LIGHTS = ("venice_sunset_000", "venice_sunset_120", "venice_sunset_240")


def settings(lights: Sequence[str]) -> dict[str, list[str]]:
    """Return the options of `lambent train` by setting."""
    together = ",".join(lights)
    return {
        "one light": ["--light", lights[0]],
        f"{len(lights)} lights, one turned": ["--light", together, "--rotated"],
        f"{len(lights)} lights, apart": ["--light", together],
    }


def run_one(name: str, options: list[str], seed: int, arguments: argparse.Namespace) -> dict[str, float]:
    """Train and evaluate one run and return its figures."""
    folder = arguments.out / f"{name.replace(', ', '_').replace(' ', '-')}_{seed}"
    result = folder / "figures.json"
    if result.exists():
        return json.loads(result.read_text())
    folder.mkdir(parents=True, exist_ok=True)
    scene, command = arguments.scene, [sys.executable, "-m", "lambent"]
    train = [*command, "train", str(scene), "--preset", arguments.preset, "--seed", str(seed), *options]
    for item in arguments.set:
        train += ["--set", item]
    started = time.perf_counter()
    subprocess.run([*train, "-o", str(folder / "run")], check=True)
    seconds = time.perf_counter() - started
    evaluate = [*command, "evaluate", str(folder / "run"), str(scene), "--repeats", "1"]
    if arguments.environments is not None:
        evaluate += ["--environments", str(arguments.environments)]
    evaluate += ["--views", str(arguments.views), "-o", str(folder / "report")]
    subprocess.run(evaluate, check=True)
    figures = figures_of(scene, folder / "report", arguments.views)
    # The mean over all lights of a run would compare different pictures.
    first = f"rgb/{arguments.lights[0]}/psnr"
    for row, kind in (("cache novel views [dB]", "pred_cache"), ("novel views [dB]", "pred")):
        figures[row] = reference_scores(scene, folder / "report" / kind, arguments.views)[first]
    figures["job [s]"] = seconds
    result.write_text(json.dumps(figures, indent=1))
    return figures


def table(runs: dict[str, list[dict[str, float]]]) -> str:
    """Return a table: a row per figure, a column per setting, mean and standard error over seeds."""
    names = list(runs)
    lines = [f"| figure | {' | '.join(names)} |", f"| --- |{' --- |' * len(names)}"]
    for row in runs[names[0]][0]:
        cells = []
        for name in names:
            values = [run[row] for run in runs[name]]
            spread = f" +- {statistics.stdev(values) / len(values) ** 0.5:.2f}" if len(values) > 1 else ""
            cells.append(f"{statistics.fmean(values):.2f}{spread}")
        lines.append(f"| {row} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Run every setting with every seed and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--environments", type=Path, help="maps of unseen lights; none: no relit pictures")
    parser.add_argument(
        "--lights", nargs="+", default=LIGHTS, help="names in the scene; the first is compared"
    )
    parser.add_argument("--only", nargs="+", help="settings to run, by their place: 0 1 2")
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--views", type=int, default=0, help="test views, evenly spaced; 0 for all")
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="settings of all runs")
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    chosen = list(settings(arguments.lights).items())
    if arguments.only:
        chosen = [chosen[int(place)] for place in arguments.only]
    runs = {
        name: [run_one(name, options, seed, arguments) for seed in arguments.seeds]
        for name, options in chosen
    }
    print(f"\n{arguments.scene.name}, preset {arguments.preset}, seeds {arguments.seeds}\n")
    print(table(runs))


if __name__ == "__main__":
    main()
