"""Server and worker agree on the sizes of textures that can be made."""

import pytest
from flashcache.config import SIZE_STEP
from flashcache.errors import ConfigError
from lambent_proto.v1 import job_pb2, worker_pb2
from lambent_run.run.spec import RunSpec
from lambent_server.api import parameters


@pytest.mark.parametrize("size", ["8", "-20", "9000", "500", "512.5", "true"])
def test_a_size_that_cannot_be_made_is_refused(size, tmp_path):
    job = job_pb2.JobSpec(preset="fast", params={"export.atlas_size": size})
    with pytest.raises(ConfigError, match=r"export\.atlas_size"):
        RunSpec.from_job(job, worker_pb2.Adjustments(), tmp_path)


def test_server_and_worker_agree_on_the_sizes_that_can_be_made():
    assert parameters.SIZE_STEP == SIZE_STEP
