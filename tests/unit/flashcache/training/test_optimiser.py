import pytest
import torch
from flashcache.config import Rates
from flashcache.training.optimiser import build_optimiser, parameter_groups


def test_adam_forgets_as_fast_as_the_papers():
    layer = torch.nn.Linear(1, 1, bias=False)
    made = build_optimiser(parameter_groups([(layer, Rates(grid=0.0, network=1e-3))]))
    start = float(layer.weight.detach())
    for gradient in (1.0, 0.0):
        layer.weight.grad.fill_(gradient)
        made.step()
    # Two steps of Adam with beta 0.9 and 0.99, written out; nothing is added to the root.
    second = 0.9 * 0.1 / (1.0 - 0.9**2) / (0.99 * 0.01 / (1.0 - 0.99**2)) ** 0.5
    assert (start - float(layer.weight.detach())) / 1e-3 == pytest.approx(1.0 + second, rel=1e-4)
