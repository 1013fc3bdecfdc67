"""Two ranks that share a GPU; gloo adds, because NCCL wants a GPU for each."""

import pytest
import torch
from support.divided_stages import STEPS, assert_close, gradients, trained
from support.two_ranks import two_ranks

pytestmark = pytest.mark.gpu
CUDA = "cuda"


@pytest.fixture(scope="module")
def both():
    with two_ranks() as made:
        yield made.both


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
