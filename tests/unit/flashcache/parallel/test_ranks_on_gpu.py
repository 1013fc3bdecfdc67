"""Ranks on a GPU: two that share one (gloo adds), and one alone by NCCL, which wants a GPU for each."""

import pytest
import torch
from flashcache.parallel.ranks import Ranks
from support.divided_stages import STEPS, assert_close, gradients, stage, trained
from support.two_ranks import two_ranks

pytestmark = pytest.mark.gpu
CUDA = "cuda"


@pytest.fixture(scope="module")
def both():
    with two_ranks() as made:
        yield made.both


@pytest.fixture
def alone(tmp_path):
    made = Ranks.join(0, 1, tmp_path / "meeting", torch.device(CUDA, 0), step_timeout_s=60.0)
    yield made
    made.close()


@pytest.mark.parametrize("case", STEPS)
def test_two_ranks_have_the_gradient_of_one_process(both, case):
    kind, step = STEPS[case]
    expected, terms = gradients(None, kind, step, {"cells": 16}, CUDA)
    assert sum(bool(gradient.any()) for gradient in expected.values()) > 5
    for found, found_terms in both(gradients, kind, step, {"cells": 16}, CUDA):
        # A GPU adds in any order.
        assert found_terms == pytest.approx(terms, rel=1e-4, abs=1e-7)
        assert_close(found, expected, 1e-3)


@pytest.mark.parametrize(("kind", "steps"), [("one", 8), ("two", 9)])
def test_two_ranks_have_the_same_bits_after_some_steps(both, kind, steps):
    _, records = trained(None, kind, steps, {"cells": 16}, CUDA)
    (first, first_records), (second, second_records) = both(trained, kind, steps, {"cells": 16}, CUDA)
    assert all(torch.equal(value, second[name]) for name, value in first.items())
    assert first_records == second_records
    for found, record in zip(first_records, records, strict=True):
        assert found == pytest.approx(record, rel=2e-2, abs=2e-3)


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
