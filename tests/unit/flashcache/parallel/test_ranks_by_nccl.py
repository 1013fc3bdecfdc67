"""A rank that is alone on a GPU, with NCCL adding its gradients."""

import pytest
import torch
from flashcache.parallel.ranks import Ranks
from support.divided_stages import stage, trained

pytestmark = pytest.mark.gpu
CUDA = "cuda"


@pytest.fixture
def alone(tmp_path):
    made = Ranks.join(0, 1, tmp_path / "meeting", torch.device(CUDA, 0), step_timeout_s=60.0)
    yield made
    made.close()


@pytest.mark.parametrize(("kind", "steps"), [("one", 8), ("two", 9)])
def test_nccl_adds_the_gradients_of_a_rank_that_is_alone(alone, kind, steps):
    _, expected = trained(None, kind, steps, {"cells": 16}, CUDA)
    _, records = trained(alone, kind, steps, {"cells": 16}, CUDA)
    for found, record in zip(records, expected, strict=True):
        assert found == pytest.approx(record, rel=2e-2, abs=2e-3)
    made = stage(kind, alone, {}, CUDA)
    assert alone.hold_the_same(made.model)
    values = torch.rand(5, 3, device=CUDA)
    assert torch.equal(alone.rows_of_all(values), values)
    assert alone.agree(3, 4) == (3, 4)
