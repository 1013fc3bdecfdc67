"""However the runs of a job fail, its stages continue with the adjustments of their failures.

The server is the real one in memory, and so are the run's reporter, its checkpoints and its loop around a
stage; only the steps of a stage are made up.
"""

from pathlib import Path

import pytest
import torch
from flashcache.errors import TrainingError
from flashcache.training.optimiser import StepRecord
from hypothesis import example, given, settings
from hypothesis import strategies as st
from lambent_proto.v1 import worker_pb2
from lambent_run.job.connection import Connection, Identity
from lambent_run.job.process import describe_failure, restore_checkpoints
from lambent_run.job.server_reporter import ServerReporter
from lambent_run.run.context import TaskContext
from lambent_run.run.parameters import JobParameters
from lambent_run.run.spec import RunSpec
from lambent_run.run.tasks.training import drive
from support.runs import Stage, staged, token
from torch import nn, optim

pytestmark = pytest.mark.slow

STEPS, EVERY = 5, 2
PARAMS = {
    "stage_one.num_steps": str(STEPS),
    "stage_two.num_steps": str(STEPS),
    "checkpoint_steps": str(EVERY),
}
# Nothing catches an interrupt, as nothing catches a kill.
ERRORS = {
    "gpu_out_of_memory": type("OutOfMemoryError", (RuntimeError,), {}),
    "diverged": TrainingError,
    "crashed": RuntimeError,
    "lost": KeyboardInterrupt,
}
FACTORS = {"gpu_out_of_memory": ("rays", 0.5), "diverged": ("rate", 0.3)}


def settings_of(config, stage):
    """Return the rays and a learning rate of a stage."""
    if stage == "cache":
        return config.stage_one.num_rays, config.stage_one.rates.network
    return config.stage_two.num_rays, config.stage_two.material_rates.network


class Remembering(ServerReporter):
    """A reporter that records which checkpoints are safe."""

    safe: dict
    made_with: tuple

    def checkpoint(self, stage, step, folder):
        super().checkpoint(stage, step, folder)
        self.safe[stage, self.made_with] = step


class FakeStage:
    """A stage whose model is nothing but the settings that it was trained with."""

    def __init__(self, config, made_with, before_step):
        self.config, self.before_step = config, before_step
        self.made_with = torch.tensor(made_with)
        self.model = nn.Linear(2, 1, bias=False)
        self.model.weight.data[0] = self.made_with
        self.optimiser = optim.SGD(self.model.parameters())
        self.steps_done = self.num_skipped = 0

    @property
    def finished(self):
        return self.steps_done >= STEPS

    def step(self):
        self.before_step(self.steps_done)
        assert torch.equal(self.model.weight[0], self.made_with), "a checkpoint of other settings is in use"
        self.steps_done += 1
        return StepRecord(step=self.steps_done, num_steps=STEPS, loss=0.0, psnr=0.0, terms={})


class FailingJob:
    """A job whose runs end as the test says, with its invariants."""

    def __init__(self, server: Stage):
        self.server = server
        self.job = server.start(params=PARAMS)
        self.run, self.alive = 1, True
        self.factors = {"cache": {}, "joint": {}}
        """What the failures so far should have changed: factors by setting, by stage."""
        self.safe = {}
        """The step of the newest checkpoint by stage and settings."""
        self.steps, self.may_take = 0, 2 * STEPS

    def fail(self, kind, stage, step):
        """End a run in `stage` before a step (-1: before it looks for checkpoints), if it comes there."""
        if not self.ends(kind, stage, step):
            return
        self.may_take += EVERY - 1
        setting, factor = FACTORS.get(kind, ("", 1.0))
        hopeless = setting in self.factors[stage]
        if setting and not hopeless:
            self.factors[stage][setting] = factor
            self.may_take += STEPS
        self.server.end(-9 if kind == "lost" else 0)
        self.server.controller.turn()
        self.server.controller.turn()
        self.run += 1
        found = self.server.job(self.job)
        self.alive = not hopeless
        assert found["state"] == ("running" if self.alive else "failed"), found["error"]

    def finish(self):
        """Run the job to its end."""
        if self.alive:
            assert not self.ends("", "", 0)
        assert self.steps <= self.may_take

    def ends(self, kind, failing, at):
        """Do the work of a run; return whether it failed as it was asked to."""
        folder = self.server.api.services.settings.runs / self.job / f"run-{self.run}"
        identity = Identity(
            job_id=self.job,
            run=self.run,
            address=self.server.address,
            token=token(self.job, self.run),
            work_dir=folder,
        )
        connection = Connection(identity)
        reporter = Remembering(connection, folder, progress_interval_s=0.001)
        reporter.safe = self.safe
        try:
            start = self.server.call("Start", self.job, self.run)
            restore_checkpoints(connection, reporter, start, folder)
            spec = RunSpec.from_job(start, JobParameters.of(start.params), folder)
            for stage in ("cache", "joint"):
                context = TaskContext(spec=spec, run_dir=folder, device="cpu", reporter=reporter, task=stage)
                self.do_task(context, ERRORS[kind] if stage == failing else None, at)
            reporter.close()
            self.server.call("Finish", self.job, self.run, outcome=worker_pb2.OUTCOME_SUCCEEDED)
            self.server.end(0)
            self.alive = False
        except tuple(ERRORS.values()) as error:
            reporter.close()
            if str(error) != "as asked":
                raise
            if kind != "lost":
                request = describe_failure(error)
                request.fence.CopyFrom(identity.fence)
                connection.call(connection.stub.Fail, request)
            return True
        finally:
            connection.close()
        return False

    def do_task(self, context, error, at):
        """Train a stage, which has the settings and continues from where it should."""
        made_with = settings_of(context.spec.config, context.task)
        plain = settings_of(RunSpec.from_options(Path(), preset="tiny").config, context.task)
        factors = [self.factors[context.task].get(name, 1.0) for name in ("rays", "rate")]
        assert made_with == pytest.approx([a * b for a, b in zip(plain, factors, strict=True)])
        context.folder.mkdir(parents=True, exist_ok=True)
        context.progress(0, 1)
        context.reporter.made_with = made_with
        began = []

        def before_step(done):
            began.append(done)
            if error is not None and done >= at:
                raise error("as asked")
            self.steps += 1

        if error is not None and at < 0:
            raise error("as asked")
        expected = self.safe.get((context.task, made_with), 0)
        config = context.spec.config
        settings = config.stage_one if context.task == "cache" else config.stage_two
        try:
            drive(context, FakeStage(settings, made_with, before_step))
        finally:
            assert (began or [STEPS])[0] == expected, "the newest checkpoint of these settings was not used"


FAILURES = st.tuples(
    st.sampled_from(sorted(ERRORS)), st.sampled_from(["cache", "joint"]), st.integers(-1, STEPS - 1)
)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    limits = {"max_failures": 10, "max_losses_without_checkpoint": 10}
    with staged(tmp_path_factory.mktemp("retries"), retry_delay_s=0.0, **limits) as server:
        yield server


@settings(max_examples=12, deadline=None)
@given(st.lists(FAILURES, min_size=2, max_size=4))
# Out of memory in one stage, diverged in the other; lost after a retry with other settings.
@pytest.mark.long
@example([("gpu_out_of_memory", "cache", 3), ("diverged", "joint", 3)])
@example([("diverged", "cache", 3), ("lost", "cache", 4), ("crashed", "joint", 3), ("lost", "joint", 4)])
@example([("diverged", "joint", 3), ("gpu_out_of_memory", "cache", -1), ("lost", "cache", 3)])
def test_no_failures_in_a_row_mix_up_settings_and_checkpoints(server, failures):
    job = FailingJob(server)
    for failure in failures:
        if job.alive:
            job.fail(*failure)
    job.finish()
