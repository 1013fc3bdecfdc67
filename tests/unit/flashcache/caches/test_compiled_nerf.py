"""The NeRF cache's answers to secondary rays from compiled code, against torch."""

from dataclasses import replace

import pytest
import torch
from flashcache.caches.nerf_cache import CacheAnswer, NerfCache
from flashcache.kernels import dispatch
from support.trained_like import CONFIG, SHAPES, secondary_rays, trained_like


def light(count: int, num_lights: int = 1) -> torch.Tensor:
    return torch.randint(num_lights, (count,), generator=torch.Generator().manual_seed(5))


def answers(
    made: NerfCache, count: int, num_lights: int = 1, *, drawn: bool = True
) -> tuple[CacheAnswer, CacheAnswer]:
    """Return the compiled answer and that of torch, with the same draws."""

    def ask() -> CacheAnswer:
        generator = torch.Generator().manual_seed(2) if drawn else None
        return made.incident(secondary_rays(count), light(count, num_lights), generator)

    with torch.no_grad():
        compiled = ask()
        with dispatch.using("reference"):
            return compiled, ask()


def assert_same(found: torch.Tensor, wanted: torch.Tensor) -> None:
    """Compare what rays answer.

    Where a proposal finds next to nothing, rounding moves a sample by much more than itself, and a draw may
    fall on the neighbour: few rays may differ visibly, as they do in torch with another rounding.
    """
    assert found.shape == wanted.shape
    difference = (found - wanted).abs()
    if len(found):
        assert float(difference.mean()) < 1e-5
        assert float((difference > 1e-4).float().mean()) < 0.01


@pytest.mark.parametrize("cells", [False, True])
@pytest.mark.parametrize("shape", list(SHAPES))
def test_the_compiled_answer_is_that_of_torch(shape, cells):
    compiled, expected = answers(trained_like(SHAPES[shape], cells=cells), 300)
    for found, wanted in zip(compiled, expected, strict=True):
        assert_same(found, wanted)
    assert 0.03 < float(expected.opacity.mean()) < 0.99


@pytest.mark.parametrize("count", [0, 1, 127, 128, 129])
def test_any_number_of_rays_is_answered(count):
    for found, wanted in zip(*answers(trained_like(), count), strict=True):
        assert_same(found, wanted)


@pytest.mark.parametrize(("colours", "sure"), [(0, 0.0), (1, 0.0), (3, 0.0), (1, 0.3), (2, 0.9)])
def test_all_colours_and_drawn_ones_are_those_of_torch(colours, sure):
    config = replace(CONFIG, secondary_colours=colours, secondary_sure_opacity=sure)
    made = trained_like(config, num_lights=3)
    for drawn in (False, True):
        for found, wanted in zip(*answers(made, 200, 3, drawn=drawn), strict=True):
            assert_same(found, wanted)


def test_rays_that_meet_no_cell_are_black_and_end_far_away():
    made = trained_like()
    rays = secondary_rays(300)
    narrow = made.occupancy.narrowed(rays)
    missed = narrow.far <= narrow.near
    compiled, _ = answers(made, 300)
    assert 10 < int(missed.sum()) < 290
    assert (compiled.near_radiance[missed] == 0.0).all()
    assert (compiled.opacity[missed] == 0.0).all()
    assert (compiled.distance[missed] == 2.0).all()


def test_lights_differ():
    made = trained_like(num_lights=2)
    with torch.no_grad():
        first, second = (
            made.incident(secondary_rays(50), torch.full((50,), index), torch.Generator().manual_seed(2))
            for index in range(2)
        )
    assert not torch.allclose(first.near_radiance, second.near_radiance)
    assert torch.equal(first.opacity, second.opacity)


def test_points_that_rays_meet_are_those_of_torch():
    made = trained_like()

    def ask():
        return made.meet(secondary_rays(200), 2, torch.Generator().manual_seed(2))

    with torch.no_grad():
        compiled = ask()
        with dispatch.using("reference"):
            expected = ask()
    met = expected.factors.reshape(-1) > 1e-3
    for name in ("opacity", "distance", "factors"):
        assert_same(getattr(compiled, name), getattr(expected, name))
    for name in ("positions", "hidden"):
        assert_same(getattr(compiled, name)[met], getattr(expected, name)[met])


def test_answers_do_not_depend_on_the_number_of_threads(monkeypatch):
    made = trained_like()
    alone, _ = answers(made, 900)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 3)
    several, _ = answers(made, 900)
    assert all(torch.equal(a, b) for a, b in zip(alone, several, strict=True))


def test_compiled_code_samples_where_no_gradients_are_recorded_and_nothing_is_jittered(monkeypatch):
    asked = []
    original = NerfCache._sample_compiled
    monkeypatch.setattr(
        NerfCache, "_sample_compiled", lambda cache, rays: asked.append(len(rays)) or original(cache, rays)
    )
    made, generator = trained_like(cells=False), torch.Generator().manual_seed(0)
    assert made.incident(secondary_rays(4), light(4), generator).near_radiance.requires_grad
    with torch.no_grad():
        made.incident(secondary_rays(4), light(4), generator, jitter=True)
        with dispatch.using("encoder"):
            made.incident(secondary_rays(4), light(4), generator)
        assert asked == []
        made.incident(secondary_rays(4), light(4), generator)
    assert asked == [4]
