"""The albedo that explains photographs, made from a known one."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from flashcache.evaluation.relighting import MapLight
from lambent_core.scene import View
from make_sample_scene import llvm_library
from support.measured_sphere import measured_views

from benchmarks.oracle_albedo import AlbedoFit, albedo_map
from benchmarks.oracle_geometry import fuse
from benchmarks.oracle_light import ProxySurface
from benchmarks.oracle_views import TrueSurface

BOX = ((-0.8, -0.8, -0.8), (0.8, 0.8, 0.8))
LIGHT = MapLight.from_image(np.full((8, 16, 3), 0.8, np.float32), torch.device("cpu"))


@pytest.fixture(scope="module")
def surface() -> ProxySurface:
    if llvm_library() is None:
        pytest.skip("needs an LLVM library to cast rays with (Debian: libllvm19)")
    views = measured_views()
    return ProxySurface(fuse(views, views, *BOX, resolution=40))


def photographed(view: View, surface: ProxySurface, brighter: float = 1.0) -> View:
    true = TrueSurface(view, surface, grid=1)
    radiance = brighter * true.radiance(LIGHT, 0, 256, 5)
    picture = np.concatenate([true.as_map(radiance), view.truth["albedo"][..., 3:]], axis=-1)
    return replace(view, images={"sky": picture.clip(0.0, 1.0).astype(np.float32)})


def fitted(surface: ProxySurface, brighter: float = 1.0) -> AlbedoFit:
    fit = AlbedoFit(surface)
    for number, view in enumerate(measured_views()):
        seen = photographed(view, surface, brighter)
        fit.observe(seen, "sky", LIGHT, bounces=0, num_directions=64, seed=number)
    return fit


@pytest.mark.slow
def test_the_albedo_behind_photographs_is_found_again_though_the_surface_is_partly_metal(
    surface: ProxySurface,
):
    albedo = fitted(surface).solve()
    view = measured_views()[2]
    found = albedo_map(surface, albedo, view, grid=2)
    truth = view.truth["albedo"]
    assert np.array_equal(found[..., 3], truth[..., 3])
    inside = truth[..., 3] == 1.0
    assert np.median(np.abs(found - truth)[inside]) < 0.01


@pytest.mark.slow
def test_saturated_channels_say_nothing(surface: ProxySurface):
    plain, bright = fitted(surface), fitted(surface, brighter=3.0)
    # The red of the upper half is the only channel that three times the light saturates.
    upper = torch.tensor(surface.vertices[:, 2] > 0.2)
    assert (plain.evidence[upper, 0] > 0.0).float().mean() > 0.9
    assert (bright.evidence[upper, 0] > 0.0).float().mean() < 0.1
    assert (bright.evidence[upper, 1] > 0.0).float().mean() > 0.9


@pytest.mark.slow
def test_what_no_photograph_shows_takes_the_albedo_of_its_surroundings(surface: ProxySurface):
    fit = AlbedoFit(surface)
    upper = max(measured_views(), key=lambda view: view.camera.position[2])
    fit.observe(photographed(upper, surface), "sky", LIGHT, bounces=0, num_directions=64, seed=0)
    albedo = fit.solve()
    assert torch.isfinite(albedo).all()
    below = torch.tensor(surface.vertices[:, 2] < -0.4)
    assert not bool((fit.evidence[below] > 0.0).any())
    assert albedo[below].min() > 0.05
    assert albedo.max() <= 1.0
