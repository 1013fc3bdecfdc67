"""Train a preset on scenes with ground truth and print the figures of the reference evaluation.

    python benchmarks/quality.py SUITE/cowcrate --seeds 0 1 2 --environments SUITE/envmaps/high_res -o OUT

Every run is a process of its own: `lambent train`, then `lambent evaluate` with 64 secondary rays per pixel.
Predictions are scored by `tests/references/evaluate.py`, which shares no code with the product: physically
based pictures, the cache's pictures, and relit pictures with and without the bounce. Results are kept in
OUT/<scene>_<seed>/; a run that is there is not repeated. Time is wall-clock time of the training job,
memory the largest resident set of its processes.
"""

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROWS = {
    "cache novel views [dB]": ("cache", "nvs/psnr"),
    "physically based novel views [dB]": ("", "nvs/psnr"),
    "albedo [dB]": ("", "albedo_rgb_ratio/psnr_gamma"),
    "albedo, interior [dB]": ("", "albedo_interior/psnr_gamma"),
    "normals, inside mask [deg]": ("", "normal/mae_mask"),
    "normals, all pixels [deg]": ("", "normal/mae_all"),
    "relit, direct only [dB]": ("direct", "relight/psnr"),
    "relit, one bounce [dB]": ("", "relight/psnr"),
    "relit, one bounce [SSIM]": ("", "relight/ssim"),
    "perceptual roughness [rmse]": ("", "roughness/rmse"),
    "metalness [rmse]": ("", "metallic/rmse"),
}
REFERENCE = Path(__file__).parent.parent / "tests" / "references" / "evaluate.py"


def run_one(scene: Path, seed: int, arguments: argparse.Namespace) -> dict[str, float]:
    """Train and evaluate one seed and return its figures by row name, with seconds and memory."""
    folder = arguments.out / f"{scene.name}_{seed}"
    result = folder / "figures.json"
    if result.exists():
        return json.loads(result.read_text())
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "lambent"]
    started = time.perf_counter()
    subprocess.run(
        [*command, "train", scene, "--preset", arguments.preset, "--seed", str(seed), "-o", folder / "run"],
        check=True,
    )
    figures = {"job [s]": time.perf_counter() - started}
    figures["peak memory [GiB]"] = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 2**20
    subprocess.run(
        [
            *(*command, "evaluate", folder / "run", scene, "--environments", arguments.environments),
            *("--repeats", "1", "--views", str(arguments.views), "-o", folder / "report"),
        ],
        check=True,
    )
    scores = {}
    for kind, name in (("", "pred"), ("cache", "pred_cache"), ("direct", "pred_direct")):
        output = subprocess.run(
            [
                *(sys.executable, REFERENCE, scene, folder / "report" / name),
                *("--max-views", str(arguments.views)),
            ],
            check=True,
            capture_output=True,
            text=True,
        )
        scores[kind] = json.loads(output.stdout)
    for row, (kind, key) in ROWS.items():
        if key in scores[kind]:
            figures[row] = scores[kind][key]
    for light in ("", "direct"):
        for key, value in scores[light].items():
            if key.startswith("rgb/") and key.endswith("/psnr"):
                figures[f"{light or 'full'} {key}"] = value
    result.write_text(json.dumps(figures, indent=1))
    return figures


def main() -> None:
    """Run everything and print one table per scene: mean, standard error over seeds, single values."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--views", type=int, default=0, help="test views, evenly spaced; 0 for all")
    parser.add_argument("-o", "--out", type=Path, required=True)
    arguments = parser.parse_args()
    for scene in arguments.scenes:
        runs = [run_one(scene, seed, arguments) for seed in arguments.seeds]
        print(f"\n{scene.name}, preset {arguments.preset}, seeds {arguments.seeds}\n")
        print("| figure | mean | standard error | runs |\n| --- | --- | --- | --- |")
        for row in runs[0]:
            values = [run[row] for run in runs]
            error = statistics.stdev(values) / len(values) ** 0.5 if len(values) > 1 else float("nan")
            single = ", ".join(f"{value:.2f}" for value in values)
            print(f"| {row} | {statistics.fmean(values):.2f} | {error:.2f} | {single} |")


if __name__ == "__main__":
    main()
