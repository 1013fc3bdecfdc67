"""Time a training step with its work divided over two cores, against the whole on two threads and on one.

    python benchmarks/two_cores.py --stage one|two [--preset fast] [--steps 25] [--quick]

All sides take the same steps of the same preset on a synthetic sphere, in turn in one process. In stage one
two halves of a batch, in stage two pass A and pass B run on a core each; the others do the same work in one
piece, with two threads inside every operation, and with one. Figures are wall-clock seconds, median and range
over the steps after two to warm up. In stage two the models of the first and the last side must end equal bit
for bit, which is printed; halves of a batch round differently.
"""

import argparse
import os
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))

import torch
from flashcache.data.ray_batches import TrainingPixels
from flashcache.data.space import domain_of
from flashcache.physical.model import InverseModel
from flashcache.presets import preset
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from lambent_worker.startup import prepare
from support.lit_sphere import lit_sphere

SIDES = {"both at once": (2, 2), "in one piece, two threads": (1, 2), "in one piece, one thread": (1, 1)}
"""Threads while the stage is made, which decides how its work is divided, and while it steps."""


def new_stage(kind: str, name: str) -> StageOne | StageTwo:
    """Return a stage of a preset where all its losses are on, on the synthetic sphere."""
    scene, config = lit_sphere(num_views=12, side=64), preset(name)
    domain = domain_of(scene, config.space, config.model.environment)
    torch.manual_seed(0)
    pixels = TrainingPixels(scene, config.pixels, torch.device("cpu"))
    model = InverseModel(config.model, domain)
    if kind == "two":
        return StageTwo(model, pixels, replace(config.stage_two, warmup_steps=0), seed=0)
    stage = StageOne(model, pixels, config.stage_one, seed=0)
    stage.steps_done = round(0.7 * config.stage_one.num_steps)
    return stage


def main() -> None:
    """Print the times, their ratios and the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--stage", choices=("one", "two"), required=True)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--steps", type=int, default=25)
    parser.add_argument("--quick", action="store_true", help="preset tiny, three steps")
    arguments = parser.parse_args()
    name, steps = ("tiny", 3) if arguments.quick else (arguments.preset, arguments.steps)
    prepare()  # As in every job: freed memory is kept, for page faults would cost more than a core gains.
    stages = {}
    for side, (threads, _) in SIDES.items():
        torch.set_num_threads(threads)
        stages[side] = new_stage(arguments.stage, name)
    seconds: dict[str, list[float]] = {side: [] for side in SIDES}
    for number in range(steps + 2):
        for side, (_, threads) in SIDES.items():
            torch.set_num_threads(threads)
            started = time.perf_counter()
            stages[side].step()
            if number >= 2:  # The first steps compile and warm up.
                seconds[side].append(time.perf_counter() - started)
    print(f"stage {arguments.stage} of preset {name}, {steps} steps each, torch {torch.__version__}")
    first = statistics.median(seconds["both at once"])
    for side, values in seconds.items():
        median = statistics.median(values)
        print(
            f"{side:26s} {median:.3f} s per step (from {min(values):.3f} to {max(values):.3f}), "
            f"{median / first:.2f} times the first"
        )
    if arguments.stage == "two":
        first, last = (stages[side].model.state_dict() for side in (next(iter(SIDES)), next(reversed(SIDES))))
        print("equal bit for bit:", all(torch.equal(first[key], last[key]) for key in first))


if __name__ == "__main__":
    main()
