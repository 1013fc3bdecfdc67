"""Stands for the process that computes a part of a benchmark: writes the marks of a result, or fails.

usage: fake_cell.py KIND FOLDER DEVICE STAGE_ONE
A cell whose ablation is "broken" fails; one that is "slow" waits until it is asked to end.
"""

import json
import signal
import sys
import time
from pathlib import Path


def main() -> int:
    kind, folder, device, stage_one = sys.argv[1], Path(sys.argv[2]), sys.argv[3], Path(sys.argv[4])
    cell = json.loads((folder / "cell.json").read_text())
    with (folder.parent.parent / "starts.txt").open("a") as log:
        log.write(f"{kind} {folder.name} {device}\n")
    if cell["ablation"] == "broken" and kind == "cell":
        print("broken on purpose")
        return 1
    if cell["ablation"] == "slow" and kind == "cell":
        return wait(folder)
    if kind == "stage-one":
        steps = stage_one / "tasks"
        steps.mkdir(parents=True, exist_ok=True)
        (steps / "cache.done.json").write_text(json.dumps({"sha256": cell["stage_one"]}))
    else:
        assert (stage_one / "tasks" / "cache.done.json").is_file(), "started before its stage one"
        (folder / "result.json").write_text(json.dumps({"inputs": cell["inputs"], "report": {"metrics": []}}))
    return 0


def wait(folder: Path) -> int:
    ended = []
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    (folder / "waiting").touch()
    for _ in range(600):
        if ended:
            (folder / "asked_to_end").touch()
            return 0
        time.sleep(0.05)
    return 1


if __name__ == "__main__":
    sys.exit(main())
