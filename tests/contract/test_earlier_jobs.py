"""Jobs as servers of earlier releases sent them are still run."""

import pytest
from lambent_proto.v1 import job_pb2, worker_pb2
from lambent_worker.run.spec import RunSpec


@pytest.mark.parametrize("preset", ["tiny", "fast", "standard", "paper_tensoir"])
def test_a_job_with_the_former_size_of_the_atlas_and_none_of_transport_runs(preset, tmp_path):
    job = job_pb2.JobSpec(preset=preset, params={"export.atlas_size": "512", "masks": "none"})
    found = RunSpec.from_job(job, worker_pb2.Adjustments(), tmp_path).config.export
    assert found.atlas_size == 512
    assert found.transport_size <= 512
