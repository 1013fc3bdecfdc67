"""Ranks that train nothing: each attempt does the next of the acts in `acts.json` of the run folder.

The file has a list for every rank's number; its last act is repeated.
"""

import json
import os
import signal
import time
from typing import Any

from flashcache.errors import RankLostError, TrainingError
from lambent_core.errors import Stopped, UsageError
from lambent_proto.v1.job_pb2 import Progress
from lambent_run.run import rank
from lambent_run.run.rank import RankReporter
from lambent_run.run.rank_processes import RankOrder


def serve(descriptor: int) -> None:
    """Stand where `lambent_run.run.rank.serve` does."""
    rank._train = play
    rank.serve(descriptor)


def play(order: RankOrder, starter: Any) -> None:
    """Do this attempt's act."""
    acts = json.loads((order.run_dir / "acts.json").read_text())[str(order.number)]
    begun = sorted(order.run_dir.glob(f"rank{order.number}-*"))
    (order.run_dir / f"rank{order.number}-{len(begun):03d}-{os.getpid()}").touch()
    reporter = RankReporter(starter, speaks=order.number == 0)
    for act in acts[min(len(begun), len(acts) - 1)].split():
        do(act, order, reporter, len(begun))


def do(act: str, order: RankOrder, reporter: RankReporter, attempt: int) -> None:
    if act == "report":
        reporter.log("told", rank=order.number)
        reporter.progress(Progress(stage=order.task, step=order.number + 1))
    elif act == "checkpoint":
        reporter.checkpoint(order.task, 5, order.run_dir)
    elif act == "meet":
        while len(list(order.run_dir.glob(f"rank*-{attempt:03d}-*"))) < order.count:
            time.sleep(0.01)
    elif act == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    elif act == "exit":
        os._exit(3)
    elif act == "lost":
        raise RankLostError("the other one is gone")
    elif act == "diverge":
        raise TrainingError("not a number")
    elif act == "misuse":
        raise UsageError("test.misused", "in words")
    elif act == "signals":
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(os.getpid(), number)
    elif act == "wait":
        while not reporter.should_stop():
            time.sleep(0.01)
        raise Stopped
    elif act == "hang":
        time.sleep(600.0)
