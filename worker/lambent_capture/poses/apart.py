"""Runs the search for cameras in a process of its own.

COLMAP works for minutes inside one call, and its library takes over the signals of the process that it is
loaded into. In a process of its own it can be ended at any time, and a crash ends nothing else. What it has
done by then is kept in its folder of work.
"""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from lambent_compute.group_signals import held_back
from lambent_core.errors import WorkerError
from lambent_core.startup import end_with_parent
from pydantic import TypeAdapter

from lambent_capture.poses.photographs import Photographs
from lambent_capture.poses.solution import Solution
from lambent_capture.poses.solve import PoseProgress, PoseSettings, solve_cameras

_PHOTOGRAPHS = TypeAdapter(Photographs)
_SETTINGS = TypeAdapter(PoseSettings)


def solve_apart(
    photographs: Photographs, work: Path, settings: PoseSettings, progress: PoseProgress
) -> Solution:
    """Return `solve.solve_cameras`, computed by a child process that ends when `progress` raises.

    Raises what `progress` raises, and `WorkerError` (`poses.crashed`) where the child ends in another way.
    """
    order = {
        "photographs": _PHOTOGRAPHS.dump_python(photographs, mode="json"),
        "work": str(work),
        "settings": _SETTINGS.dump_python(settings, mode="json"),
    }
    work.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-P", "-m", "lambent_capture.poses.apart"]
    with (work / "colmap.log").open("wb") as log:
        # Ctrl-C is for this process: `progress` raises, or KeyboardInterrupt ends the child below.
        with held_back("SIGINT"):
            child = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=log, text=True
            )
        assert child.stdin is not None
        assert child.stdout is not None
        try:
            child.stdin.write(json.dumps(order))
            child.stdin.close()
            for line in child.stdout:
                told = json.loads(line)
                progress(told["phase"], told["done"], told["total"])
            code = child.wait()
        finally:
            child.kill()
            child.wait()
            child.stdout.close()
    if code:
        said = (work / "colmap.log").read_text(errors="replace").strip().splitlines()
        raise WorkerError(
            "poses.crashed",
            f"the search for cameras ended with code {code}"
            + (f" ({said[-1][:200]})" if said else "")
            + f"; the log is {work / 'colmap.log'}; run it again to continue from what was found",
        )
    # Everything is there, so this only reads it.
    return solve_cameras(photographs, work, settings)


def main() -> None:
    """Do the search that the order on standard input describes, and tell its progress line by line."""
    end_with_parent(signal.SIGKILL)
    order: dict[str, Any] = json.load(sys.stdin)

    def tell(phase: str, done: int, total: int) -> None:
        print(json.dumps({"phase": phase, "done": done, "total": total}), flush=True)

    solve_cameras(
        _PHOTOGRAPHS.validate_python(order["photographs"]),
        Path(order["work"]),
        _SETTINGS.validate_python(order["settings"]),
        tell,
    )


if __name__ == "__main__":
    main()
