"""Work on several cores gives the results that it gives on one, in order."""

import time

import pytest
import torch
from flashcache.evaluation import gbuffer, monte_carlo
from flashcache.evaluation.threads import on_all_cores
from flashcache.evaluation.views import PictureSamples, render_gbuffer, render_physical
from support.lit_sphere import camera
from support.sphere_model import sphere_model

CPU = torch.device("cpu")


@pytest.fixture(params=[1, 3])
def num_threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def test_results_are_in_order_without_gradients_and_each_on_one_core(num_threads):
    weight = torch.ones(2, requires_grad=True)

    def work(number):
        time.sleep(0.01 * (3 - number))
        return number, (number * weight).requires_grad, torch.get_num_threads()

    assert on_all_cores(work, range(4), CPU) == [(number, False, 1) for number in range(4)]
    assert torch.is_grad_enabled()
    assert torch.get_num_threads() == num_threads


def test_a_mistake_in_a_part_is_raised():
    with pytest.raises(ZeroDivisionError):
        on_all_cores(lambda number: 1 // number, (2, 1, 0), CPU)


def test_nothing_to_do_gives_nothing():
    assert on_all_cores(lambda number: number, (), CPU) == []


def test_pictures_are_the_same_for_any_number_of_threads(monkeypatch):
    for module in (gbuffer, monte_carlo):
        monkeypatch.setattr(module, "CHUNK_RAYS", 7)
    model, view = sphere_model().requires_grad_(False), camera(0.4, 0.3, side=6)
    found, before = [], torch.get_num_threads()
    for count in (1, 3):
        torch.set_num_threads(count)
        physical = render_physical(model, view, PictureSamples(num_directions=8))
        found.append((physical.rgb, render_gbuffer(model, view).cache_rgb))
    torch.set_num_threads(before)
    for one, three in zip(*found, strict=True):
        assert one.any()
        assert (one == three).all()
