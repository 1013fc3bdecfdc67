"""Jobs as servers of earlier releases sent them are still run."""

import pytest
from flashcache.config import SIZE_STEP
from flashcache.errors import ConfigError
from lambent_proto.v1 import job_pb2, worker_pb2
from lambent_run.job.order import Order
from lambent_run.job.process import train
from lambent_run.run import pipeline
from lambent_run.run.spec import RunSpec
from lambent_server.api import parameters as job_parameters
from support.recording_reporter import RecordingReporter


@pytest.mark.parametrize("preset", ["tiny", "fast", "standard", "paper_tensoir"])
def test_a_job_with_the_former_size_of_the_atlas_and_none_of_transport_runs(preset, tmp_path):
    job = job_pb2.JobSpec(preset=preset, params={"export.atlas_size": "512", "masks": "none"})
    found = RunSpec.from_job(job, worker_pb2.Adjustments(), tmp_path).config.export
    assert found.atlas_size == 512
    assert found.transport_size <= 512


@pytest.mark.parametrize(
    ("asked", "sizes"),
    [
        ({"atlas_size": "500"}, (496, 496)),
        ({"atlas_size": "1000"}, (992, 512)),
        ({"atlas_size": "1030", "transport_size": "300"}, (1024, 288)),
        ({"transport_size": "250"}, (0, 240)),
    ],
)
def test_a_job_with_sizes_that_cannot_be_made_any_more_is_run_with_the_ones_below(asked, sizes, tmp_path):
    job = job_pb2.JobSpec(preset="fast", params={f"export.{name}": size for name, size in asked.items()})
    found = RunSpec.from_job(job, worker_pb2.Adjustments(), tmp_path).config.export
    assert (found.atlas_size, found.transport_size) == sizes


@pytest.mark.parametrize("size", ["8", "-20", "9000", "512.5", "true"])
def test_a_size_that_never_was_one_is_still_refused(size, tmp_path):
    job = job_pb2.JobSpec(preset="fast", params={"export.atlas_size": size})
    with pytest.raises(ConfigError, match=r"export\.atlas_size"):
        RunSpec.from_job(job, worker_pb2.Adjustments(), tmp_path)


def test_the_owner_is_told_of_a_size_that_was_rounded(tmp_path, monkeypatch):
    ran, reporter = [], RecordingReporter()
    monkeypatch.setattr(pipeline, "run_pipeline", lambda spec, *_, **__: ran.append(spec))
    params = {"export.atlas_size": "1030", "export.transport_size": "512"}
    train(
        Order(
            spec=job_pb2.JobSpec(preset="fast", params=params),
            scene_dir=tmp_path / "scene",
            run_dir=tmp_path,
            device="cpu",
            adjustments=worker_pb2.Adjustments(),
            reporter=reporter,
        )
    )
    assert ran[0].config.export.atlas_size == 1024
    (told,) = reporter.named("finding")
    assert told["code"] == "config.size_rounded"
    assert "export.atlas_size is 1024 instead of 1030" in told["message"]


def test_server_and_worker_agree_on_the_sizes_that_can_be_made():
    assert job_parameters.SIZE_STEP == SIZE_STEP
