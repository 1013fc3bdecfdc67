"""Server and worker agree on the sizes of textures that can be made."""

import pytest
from flashcache.config import SIZE_STEP
from flashcache.errors import ConfigError
from lambent_proto.v1 import worker_pb2
from lambent_run.run.parameters import JobParameters
from lambent_run.run.spec import RunSpec
from lambent_server.api import parameters


@pytest.mark.parametrize("size", ["8", "-20", "9000", "500", "512.5", "true"])
def test_a_size_that_cannot_be_made_is_refused(size, tmp_path):
    start = worker_pb2.StartResponse(preset="fast")
    parameters = JobParameters.of({"export.atlas_size": size})
    with pytest.raises(ConfigError, match=r"export\.atlas_size"):
        RunSpec.from_job(start, parameters, tmp_path)


def test_server_and_worker_agree_on_the_sizes_that_can_be_made():
    assert parameters.SIZE_STEP == SIZE_STEP
