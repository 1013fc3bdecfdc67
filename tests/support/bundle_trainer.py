# ruff: noqa: E402 (the path comes before what is found on it)
"""A run process whose training makes an analytic bundle at once; everything else is the real worker.

`python bundle_trainer.py run` stands where `python -m lambent_run run` would.
"""

import sys
from pathlib import Path

# Not the folder of this file: it has modules with names of the standard library.
sys.path[0] = str(Path(__file__).resolve().parents[1])

from lambent_capture.checks.check_result import CaptureCheck
from lambent_run.job.order import Order
from lambent_run.job.process import work
from lambent_run.job.supervisor import supervise
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere
from support.sleep_trainer import check


def pipeline(order: Order) -> Path:
    """Return a bundle of one grey ball."""
    return write_analytic_bundle(order.run_dir / "bundle", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))


def accept(scene_dir: Path) -> CaptureCheck:
    """Accept every scene."""
    return check(scene_dir)


if __name__ == "__main__":
    if sys.argv[1:] == ["run"]:
        sys.exit(supervise([sys.executable, __file__, "work"]))
    sys.exit(work(pipeline, accept))
