import torch
from flashcache.losses.fast_cache import fast_cache_loss
from flashcache.physical.incident import Incident, RayLimits

LIMITS = RayLimits(near=0.05, far=2.0)
INSIDE = torch.ones(3)


def incident(radiance: float = 0.5, opacity: float = 0.8, distance: float = 1.0) -> Incident:
    return Incident(
        torch.full((3, 3), radiance).requires_grad_(),
        torch.full((3,), opacity).requires_grad_(),
        torch.full((3,), distance).requires_grad_(),
    )


def test_the_loss_is_zero_exactly_at_the_nerf_caches_answer():
    assert fast_cache_loss(incident(), incident(), INSIDE, LIMITS) < 1e-12
    for other in (incident(radiance=0.6), incident(opacity=0.7), incident(distance=1.2)):
        assert fast_cache_loss(other, incident(), INSIDE, LIMITS) > 1e-4


def test_the_nerf_cache_gets_no_gradient():
    answer, target = incident(radiance=0.6, opacity=0.7, distance=1.2), incident()
    fast_cache_loss(answer, target, INSIDE, LIMITS).backward()
    for name in ("near_radiance", "opacity", "distance"):
        assert getattr(target, name).grad is None
        assert getattr(answer, name).grad.any()


def test_distance_counts_only_where_the_ray_is_mostly_blocked():
    clear = incident(opacity=0.4)
    assert fast_cache_loss(incident(opacity=0.4, distance=0.3), clear, INSIDE, LIMITS) < 1e-12


def test_rays_from_outside_do_not_count():
    answer = incident(radiance=0.9)
    fast_cache_loss(answer, incident(), torch.tensor([1.0, 0.0, 1.0]), LIMITS).backward()
    assert answer.near_radiance.grad[0].any()
    assert not answer.near_radiance.grad[1].any()


def test_the_two_halves_count_alike_however_many_rays_they_have():
    answer, target = incident(), incident()
    with torch.no_grad():
        answer.opacity[0] = 0.6
    from_diffuse = torch.tensor([True, False, False])
    together = fast_cache_loss(answer, target, INSIDE, LIMITS)
    by_half = fast_cache_loss(answer, target, INSIDE, LIMITS, from_diffuse=from_diffuse)
    torch.testing.assert_close(by_half, 1.5 * together)


def test_a_half_without_rays_costs_nothing():
    answer = incident(radiance=0.6)
    none = torch.zeros(3, dtype=torch.bool)
    expected = 0.5 * fast_cache_loss(answer, incident(), INSIDE, LIMITS)
    torch.testing.assert_close(
        fast_cache_loss(answer, incident(), INSIDE, LIMITS, from_diffuse=none), expected
    )
