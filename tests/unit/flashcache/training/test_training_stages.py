"""Both stages on a scene with a known answer: they learn, resume exactly, and keep to their parameters."""

from dataclasses import replace

import pytest
import torch
from flashcache.config import Config, DistilConfig
from flashcache.data.ray_batches import TrainingPixels
from flashcache.errors import TrainingError
from flashcache.losses.metalness import MetalnessPriorConfig
from flashcache.losses.priors import grid_decay
from flashcache.losses.shape import ShapePriorConfig
from flashcache.physical.model import InverseModel
from flashcache.presets import PRESETS, preset, tiny
from flashcache.training.checkpoint import CheckpointState, load_checkpoint, save_checkpoint
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.lit_sphere import lit_domain, lit_sphere

CPU = torch.device("cpu")
SCENE = lit_sphere()
DOMAIN = lit_domain(SCENE)


def small(steps_one: int = 4, steps_two: int = 4) -> Config:
    base = tiny()
    return replace(
        base,
        stage_one=replace(base.stage_one, num_steps=steps_one, num_rays=64, normal_rays=0.5),
        stage_two=replace(
            base.stage_two, num_steps=steps_two, num_rays=32, warmup_steps=1, distil=DistilConfig()
        ),
    )


def model_of(config: Config, seed: int = 0) -> InverseModel:
    torch.manual_seed(seed)
    return InverseModel(config.model, DOMAIN)


def stage_of(kind: str, config: Config, seed: int = 0) -> StageOne | StageTwo:
    pixels = TrainingPixels(SCENE, config.pixels, CPU)
    model = model_of(config)
    if kind == "cache":
        return StageOne(model, pixels, config.stage_one, seed=seed)
    return StageTwo(model, pixels, config.stage_two, seed=seed)


def weights_of(stage: StageOne | StageTwo) -> dict[str, torch.Tensor]:
    return {name: value.clone() for name, value in stage.model.state_dict().items()}


@pytest.mark.parametrize("kind", ["cache", "joint"])
def test_resuming_equals_not_stopping_bit_for_bit(kind, tmp_path):
    config = small(6, 6)
    whole = stage_of(kind, config)
    while not whole.finished:
        whole.step()

    first = stage_of(kind, config)
    for _ in range(3):
        first.step()
    state = CheckpointState(stage=kind, step=first.steps_done, seed=0, config_sha256="x")
    save_checkpoint(tmp_path / "step_3", first.model, first.optimiser, state)
    second = stage_of(kind, config)
    second.steps_done = load_checkpoint(tmp_path / "step_3", second.model, second.optimiser).step
    while not second.finished:
        second.step()

    expected, found = weights_of(whole), weights_of(second)
    assert all(torch.equal(expected[name], found[name]) for name in expected)


@pytest.mark.parametrize("name", ["model", "optimiser"])
def test_a_damaged_checkpoint_is_refused_before_anything_is_filled_in(name, tmp_path):
    model, other = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)
    state = CheckpointState(stage="cache", step=1, seed=0, config_sha256="")
    save_checkpoint(tmp_path / "step_1", other, torch.optim.Adam(other.parameters()), state)
    path = tmp_path / "step_1" / f"{name}.safetensors"
    path.write_bytes(path.read_bytes()[:-1] if name == "model" else b"damaged")
    before = model.weight.clone()
    with pytest.raises(TrainingError, match="cannot be read"):
        load_checkpoint(tmp_path / "step_1", model, torch.optim.Adam(model.parameters()))
    assert torch.equal(model.weight, before)


@pytest.mark.parametrize("kind", ["cache", "joint"])
def test_another_seed_gives_another_model(kind):
    one, two = stage_of(kind, small()), stage_of(kind, small(), seed=1)
    one.step(), two.step()
    a, b = weights_of(one), weights_of(two)
    assert any(not torch.equal(a[name], b[name]) for name in a)


def test_priors_on_shape_and_metal_act_in_the_steps_they_are_meant_for():
    config = small(5, 3)
    prior = ShapePriorConfig(recession_weight=0.2, flatness_weight=0.03)
    config = replace(config, stage_one=replace(config.stage_one, shape_prior=prior))
    terms = {}
    for kind in ("cache", "joint"):
        stage = stage_of(kind, config)
        terms[kind] = []
        while not stage.finished:
            terms[kind].append(stage.step().terms)
    # Carving is the first of five steps; normals count from the second on.
    assert ["recession" in step for step in terms["cache"]] == [True, False, False, False, False]
    assert ["flatness" in step for step in terms["cache"]] == [False, True, True, True, True]
    assert all(step["metalness"] > 0.0 for step in terms["joint"])


def test_rates_fall_as_their_setting_says():
    config, rates = small(4), []
    for decay in ("log_linear", "linear"):
        settings = {"decay": decay, "warmup_steps": 2, "final_rate": 0.01}
        stage = stage_of("cache", replace(config, stage_one=replace(config.stage_one, **settings)))
        while not stage.finished:
            stage.step()
        rates.append(stage.optimiser.param_groups[0]["lr"] / stage.optimiser.param_groups[0]["peak"])
    # The last of four steps: three quarters of the whole way, and half of that after the warm-up.
    assert rates == pytest.approx([0.01**0.75, 1.0 - 0.5 * 0.99])


def test_stage_one_changes_the_nerf_cache_only():
    stage = stage_of("cache", small())
    before = weights_of(stage)
    stage.step(), stage.step()
    after = weights_of(stage)
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"nerf"}


def test_stage_two_changes_everything_but_the_proposals():
    stage = stage_of("joint", small())
    before = weights_of(stage)
    for _ in range(3):
        stage.step()
    after = weights_of(stage)
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert {name.split(".")[0] for name in changed} == {
        "nerf",
        "environment",
        "materials",
        "fast",
        "light_sampler",
    }
    assert not any(name.startswith("nerf.proposals") for name in changed)


def test_warming_up_leaves_materials_and_environment_alone():
    config = small()
    without_prior = MetalnessPriorConfig()
    config = replace(
        config, stage_two=replace(config.stage_two, warmup_steps=4, metalness_prior=without_prior)
    )
    stage = stage_of("joint", config)
    before = weights_of(stage)
    for _ in range(3):
        stage.step()
    after = weights_of(stage)
    changed = {name.split(".")[0] for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"nerf", "fast", "light_sampler"}


def test_the_scale_of_light_and_albedo_is_the_models():
    stage = stage_of("joint", small())
    with torch.no_grad():
        stage.model.environment.head.weight.zero_()
        stage.model.environment.head.bias.fill_(stage.model.environment.config.bias * -1.0)
        stage.model.materials.head.weight.zero_()
    scale = stage.scale()
    softplus_of_zero, sigmoid_of_bias = 0.6931, 1.0 / (1.0 + 2.7183)
    assert scale["environment_mean_sky"] == pytest.approx(softplus_of_zero, abs=1e-3)
    assert scale["albedo_mean"] == pytest.approx(sigmoid_of_bias, abs=1e-3)


@pytest.mark.parametrize("mode", ["off", "fast_only"])
def test_stage_two_runs_without_the_control_variate(mode):
    config = small()
    estimator = replace(config.stage_two.estimator, control_variate=mode)
    config = replace(config, stage_two=replace(config.stage_two, estimator=estimator, points="depth"))
    record = None
    stage = stage_of("joint", config)
    while not stage.finished:
        record = stage.step()
    assert record is not None
    assert not record.skipped


def late_terms(**settings) -> dict[str, float]:
    """Return the losses of stage one at two thirds of the training."""
    config = small()
    one = replace(config.stage_one, num_steps=300, normal_every=1, **settings)
    stage = stage_of("cache", replace(config, stage_one=one))
    stage.steps_done = 200
    return dict(stage.step().terms)


def test_the_weight_of_derived_normals_changes_the_orientation_loss_of_stage_one_only():
    usual, other = (
        late_terms(orientation_weight=0.1),
        late_terms(orientation_weight=0.1, orientation_derived=0.0),
    )
    assert {name for name in usual if usual[name] != other[name]} == {"orientation"}
    assert other["orientation"] < usual["orientation"]


def test_the_normal_loss_follows_its_ramp():
    ramp = {"normal_start": 0.25, "normal_weight": 1.0}
    ends = (late_terms(normal_ramp=span, **ramp)["normals"] for span in ((0.8, 0.9), (0.1, 0.2)))
    before, after = ends
    middle = late_terms(normal_ramp=(0.5, 2.0 / 3.0 + (2.0 / 3.0 - 0.5)), **ramp)["normals"]
    assert before == pytest.approx(0.25 * after, rel=1e-5)
    assert middle == pytest.approx(0.625 * after, rel=1e-5)


def test_the_decay_of_stage_one_reaches_proposals_and_density():
    config = small()
    stage = stage_of("cache", replace(config, stage_one=replace(config.stage_one, grid_decay=1.0)))
    densities = (*stage.model.nerf.proposals, stage.model.nerf.density)
    expected = float(grid_decay(density.grid for density in densities).detach())
    assert stage.step().terms["grid_decay"] == pytest.approx(expected, rel=1e-5)


def test_a_gradient_that_is_not_finite_changes_nothing():
    stage = stage_of("cache", small())
    with torch.no_grad():
        stage.model.nerf.appearance.heads.bias[0] = float("nan")
    before = weights_of(stage)
    record = stage.step()
    after = weights_of(stage)
    assert record.skipped
    assert stage.num_skipped == 1
    same = [torch.equal(before[n].nan_to_num(), after[n].nan_to_num()) for n in before]
    assert all(same)


@pytest.mark.slow
def test_stage_one_learns_the_sphere():
    base = tiny()
    config = replace(base, stage_one=replace(base.stage_one, num_steps=160, num_rays=256, warmup_steps=10))
    stage = stage_of("cache", config)
    first = stage.step().psnr
    while not stage.finished:
        record = stage.step()
    assert record.psnr > first + 8.0
    assert record.psnr > 20.0


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in PRESETS if name not in ("tiny", "fast")])
def test_every_large_preset_takes_steps_of_both_stages(name):
    config = preset(name)
    share = 64 if name.startswith("paper") else 16
    config = replace(
        config,
        stage_one=replace(config.stage_one, num_rays=config.stage_one.num_rays // share, warmup_steps=1),
        stage_two=replace(config.stage_two, num_rays=config.stage_two.num_rays // share, warmup_steps=0),
    )
    pixels = TrainingPixels(SCENE, config.pixels, CPU)
    model = model_of(config)
    for stage in (
        StageOne(model, pixels, config.stage_one, seed=0),
        StageTwo(model, pixels, config.stage_two, seed=0),
    ):
        for _ in range(3 if name == "paper_tensoir" else 1):
            record = stage.step()
            assert not record.skipped
        assert all(torch.isfinite(value).all() for value in model.state_dict().values())
