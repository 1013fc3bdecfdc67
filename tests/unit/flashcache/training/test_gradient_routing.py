"""Each loss of stage two moves the parts of the model that it should, term by term."""

from dataclasses import replace

import pytest
import torch
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.training.joint_losses import physical_loss
from flashcache.training.stage_two import StageTwo
from support.joint_stage import stage, terms_of_step

PARTS = (
    "nerf.proposals",
    "nerf.density",
    "nerf.normals",
    "nerf.appearance",
    "materials",
    "environment",
    "fast",
    "light_sampler",
)
SHAPE = {"nerf.density", "nerf.normals"}
HEADS = {"nerf.appearance"}
REACHED = {
    "colour": SHAPE | HEADS,
    "mask": {"nerf.density"},
    "normals": SHAPE,
    "orientation": SHAPE,
    "distortion": {"nerf.density"},
    "physical": {"materials", "environment", "nerf.normals"},
    "consistency_diffuse": HEADS,
    "consistency_specular": HEADS,
    "consistency_irradiance": HEADS,
    "smoothness": {"materials"},
    "clusters": {"materials"},
    "gloss": {"materials"},
    "metalness": {"materials"},
    "grey": {"environment"},
    "tint": {"environment"},
    "fast": {"fast"},
    "sampler": {"light_sampler"},
    "grid_decay": {"nerf.density", "materials", "light_sampler"},
}


def sizes(made: StageTwo, term: torch.Tensor) -> dict[str, float]:
    """Return the largest gradient of a term in each part of the model that it reaches."""
    found = {}
    for part in PARTS:
        parameters = [p for p in made.model.get_submodule(part).parameters() if p.requires_grad]
        for parameter in parameters:
            if parameter.grad is not None:
                parameter.grad.zero_()
    term.backward(retain_graph=True)
    for part in PARTS:
        gradients = [p.grad for p in made.model.get_submodule(part).parameters() if p.grad is not None]
        largest = max((float(g.abs().max()) for g in gradients), default=0.0)
        if largest:
            found[part] = largest
    return found


@pytest.fixture(scope="module")
def reached() -> dict[str, set[str]]:
    made = stage()
    terms = terms_of_step(made)
    return {name: set(sizes(made, term)) for name, term in terms.items()}


def test_every_loss_of_stage_two_is_in_the_table(reached):
    assert set(reached) == set(REACHED)


@pytest.mark.parametrize("name", REACHED)
def test_a_loss_moves_the_parts_it_should_and_no_other(reached, name):
    assert reached[name] == REACHED[name]


def physical_gradients(**settings) -> dict[str, float]:
    base = tiny().stage_two.estimator
    made = stage(estimator=replace(base, **settings))
    return sizes(made, terms_of_step(made)["physical"])


def test_gradients_through_the_caches_reach_their_parts_in_proportion():
    small, large = (physical_gradients(through_cache=factor) for factor in (1e-4, 1e-2))
    for part in ("nerf.density", "nerf.appearance", "fast"):
        assert large[part] == pytest.approx(100.0 * small[part], rel=1e-3)
    assert large["materials"] == pytest.approx(small["materials"], rel=1e-5)


def test_the_factor_on_the_normal_is_that_of_its_setting():
    usual, more = (physical_gradients(normal_gradient=factor)["nerf.normals"] for factor in (0.01, 0.05))
    assert more == pytest.approx(5.0 * usual, rel=1e-3)


def test_the_width_gets_a_quarter_of_its_gradient():
    config = tiny()
    gradients = []
    for factor in (1.0, 0.25):
        materials = replace(config.model.materials, alpha_gradient=factor)
        made = stage(replace(config, model=replace(config.model, materials=materials)))
        terms_of_step(made)["physical"].backward()
        gradients.append(made.model.materials.gloss.head.bias.grad[0])
    torch.testing.assert_close(gradients[1], 0.25 * gradients[0])


def terms_of(**settings) -> dict[str, float]:
    return {name: float(term.detach()) for name, term in terms_of_step(stage(**settings)).items()}


def changed(**settings) -> set[str]:
    """Return the losses that a setting changes."""
    usual, other = terms_of(), terms_of(**settings)
    return {name for name in usual if usual[name] != other.get(name)}


def test_counting_halves_alike_changes_the_loss_of_the_fast_cache_only():
    assert changed(fast_by_half=True) == {"fast"}


def test_distances_enter_the_fast_caches_loss_by_their_weight():
    losses = []
    for weight in (0.0, 0.1, 0.2):
        made = stage(distance_weight=weight)
        with torch.no_grad():
            made.model.nerf.density.head.bias.add_(5.0)  # Opaque, so that distances count.
        losses.append(float(terms_of_step(made)["fast"].detach()))
    assert losses[1] > losses[0]
    assert losses[2] - losses[0] == pytest.approx(2.0 * (losses[1] - losses[0]), rel=1e-3)


def test_the_weight_of_derived_normals_changes_the_orientation_loss_only():
    assert changed(orientation_derived=0.0) == {"orientation"}


def test_jitter_of_secondary_rays_reaches_what_comes_from_the_nerf_cache():
    assert {"physical", "fast", "sampler"} <= changed(secondary_jitter=True)


def test_the_radius_of_the_fast_caches_loss_is_the_domains():
    made, near = stage(), stage()
    near.model.domain = replace(near.model.domain, fast_radius=1e-3)
    assert float(terms_of_step(made)["fast"].detach()) > 0.0
    assert float(terms_of_step(near)["fast"].detach()) == 0.0


def test_the_fast_cache_alone_is_taught_once_a_step(monkeypatch):
    asked = []
    made = stage(estimator=replace(tiny().stage_two.estimator, control_variate="fast_only"))
    right = InverseModel.ask_nerf

    def counted(self, rays, generator, **options):
        asked.append(len(rays))
        return right(self, rays, generator, **options)

    monkeypatch.setattr(InverseModel, "ask_nerf", counted)
    terms = terms_of_step(made)
    assert len(asked) == 1
    assert {"fast", "sampler"} <= set(terms)


def test_two_symmetric_passes_weigh_half_each():
    made = stage()
    batch = made.pixels.draw(20, torch.Generator().manual_seed(0))
    cache, picture, other = torch.rand(3, 20, 3, generator=torch.Generator().manual_seed(1))
    one, both = (
        physical_loss(replace(made.config, symmetric=flag), batch, cache, picture, other)
        for flag in (False, True)
    )
    torch.testing.assert_close(both, 0.5 * one)
