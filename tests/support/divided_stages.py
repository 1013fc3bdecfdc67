"""Stages of training with every loss switched on, for one process and for ranks; see `support.two_ranks`."""

from dataclasses import replace

import torch
from flashcache.config import Config, DistilConfig
from flashcache.data.hull import fit_occupancy
from flashcache.data.ray_batches import TrainingPixels
from flashcache.encoding.occupancy import OccupancyConfig
from flashcache.errors import ConfigError
from flashcache.losses.shape import ShapePriorConfig
from flashcache.parallel.ranks import Ranks, divided_among
from flashcache.physical.model import InverseModel
from flashcache.presets import tiny
from flashcache.rows import fixed_shapes
from flashcache.training.stage_one import StageOne
from flashcache.training.stage_two import StageTwo
from support.joint_stage import EVERYTHING
from support.lit_sphere import lit_domain, lit_sphere

Stage = StageOne | StageTwo
STEPS = {"carving": ("one", 0), "one": ("one", 6), "two": ("two", 1), "distillation": ("two", 7)}
"""Steps of all phases: stage and number."""
SCENE = lit_sphere(num_views=4)
SOLID = 4.0
"""Added to the density before its activation, so that rays end on something."""
ONE = {
    "num_rays": 32,
    "num_steps": 8,
    "normal_every": 1,
    "normal_rays": 0.5,
    "orientation_weight": 0.1,
    "mask_weight": 1.0,
    "distortion_weight": 0.1,
    "distortion_from": 0.0,
    "random_background": True,
    "grid_decay": 1.0,
    "shape_prior": ShapePriorConfig(
        recession_weight=0.1,
        flatness_weight=0.1,
        flatness_rays=16,
        emptiness_weight=0.1,
        emptiness_points=64,
    ),
}
# Around what an untrained model has, so that both tests of metals say something.
METALNESS = replace(EVERYTHING["metalness_prior"], variation=(0.0, 0.03), bright_variation=(0.0, 0.05))
TWO = EVERYTHING | {
    "num_rays": 32,
    "num_steps": 6,
    "fast_by_half": True,
    "normal_rays": 0.5,
    "metalness_prior": METALNESS,
}


def config(cells: int = 0, **changes) -> Config:
    """Return the configuration of both stages; `cells` other than 0 rules out empty space."""
    base = tiny()
    if changes.get("estimator") == "stratified":
        changes["estimator"] = replace(
            base.stage_two.estimator, stratified=not base.stage_two.estimator.stratified
        )
    one, two = ({name: value for name, value in changes.items() if name in of} for of in (ONE, TWO))
    more = {name: value for name, value in changes.items() if name not in ONE and name not in TWO}
    distil = DistilConfig(num_steps=3, num_points=32)
    return replace(
        base,
        model=replace(base.model, occupancy=OccupancyConfig(cells=cells)),
        stage_one=replace(base.stage_one, **(ONE | one)),
        stage_two=replace(base.stage_two, distil=distil, **(TWO | two | more)),
    )


def stage(
    kind: str, ranks: Ranks | None, settings: dict, device: str = "cpu", *, fixed: bool = True
) -> Stage:
    """Return stage "one" or "two", past an initial state in which heads give zero."""
    made = config(**settings)
    torch.manual_seed(0)
    model = InverseModel(made.model, lit_domain(SCENE))
    fit_occupancy(model, SCENE)
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(0.02 * torch.randn(parameter.shape))
        model.nerf.density.head.bias[0] += SOLID
    model = model.to(device)
    pixels = TrainingPixels(SCENE, made.pixels, torch.device(device), model.nerf.occupancy)
    if kind == "one":
        return StageOne(model, pixels, made.stage_one, seed=0, fixed=fixed, ranks=ranks)
    return StageTwo(model, pixels, made.stage_two, seed=0, fixed=fixed, ranks=ranks)


def gradients(
    ranks: Ranks | None, kind: str, step: int, settings: dict, device: str = "cpu"
) -> tuple[dict, dict]:
    """Return the gradients of a step by parameter, and its loss terms with the PSNR."""
    made = stage(kind, ranks, settings, device)
    made.steps_done = step
    if kind == "one":
        made.losses.prepare(step, torch.device(device))
    late = step - made.config.num_steps if kind == "two" else -1
    if late >= 0:
        made._begin_distillation()
    differentiate = made._differentiate if late < 0 else made._differentiate_fast
    with fixed_shapes(), divided_among(ranks):
        terms = {name: float(value) for name, value in differentiate().items()}
    optimised = {id(p) for group in made.optimiser.param_groups for p in group["params"]}
    named = made.model.named_parameters()
    found = {n: p.grad.cpu().clone() for n, p in named if id(p) in optimised and p.grad is not None}
    return found, terms


def trained(
    ranks: Ranks | None, kind: str, steps: int, settings: dict, device: str = "cpu"
) -> tuple[dict, list[dict]]:
    """Return the model's values after some steps, and the loss terms of each with its PSNR."""
    made = stage(kind, ranks, settings, device)
    records = [made.step().read() for _ in range(steps)]
    values = {name: value.cpu().clone() for name, value in made.model.state_dict().items()}
    return values, [{**record.terms, "psnr": record.psnr, "skipped": record.skipped} for record in records]


def assert_close(found: dict, expected: dict, relative: float) -> None:
    """Compare tensors by name, relative to the largest magnitude in each."""
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        difference = float((found[name].double() - value.double()).abs().max())
        assert difference <= relative * float(value.abs().max()) + 1e-9, name


def stepped_with_nan(ranks: Ranks, kind: str) -> tuple[int, bool]:
    """Return how many of two steps were skipped, the first for a NaN on the second rank, and what changed."""
    made = stage(kind, ranks, {})
    before = {name: value.clone() for name, value in made.model.state_dict().items()}
    take, made._differentiate = made._differentiate, lambda: spoilt(ranks, made, take)
    made.step()
    changed = any(not torch.equal(value, before[name]) for name, value in made.model.state_dict().items())
    made._differentiate = take
    made.step()
    return made.steps.read() + made.num_skipped, changed


def spoilt(ranks: Ranks, made: Stage, take) -> dict:
    """Differentiate with a loss that is not a number on the second rank."""
    part, losses = made.parts._own, made.parts._own.losses

    def no_number(*arguments):
        loss, found = losses(*arguments)
        return loss * torch.nan, found

    part.losses = no_number if ranks.number == 1 else losses
    found = take()
    part.losses = losses
    return found


def held_the_same(ranks: Ranks, kind: str, spoil: int | None) -> bool:
    """Return whether ranks find that they have the same values, after one bit changed on rank `spoil`."""
    made = stage(kind, ranks, {})
    if ranks.number == spoil:
        with torch.no_grad():
            made.model.nerf.density.head.bias.view(torch.int32)[0] ^= 1
    return ranks.hold_the_same(made.model)


def agreed(ranks: Ranks) -> tuple[int, ...]:
    """Return what ranks agree on if each says something else."""
    return ranks.agree(10 * ranks.number + 1, -ranks.number)


def too_many(ranks: Ranks) -> str:
    """Return why a batch of one ray cannot be divided."""
    try:
        stage("one", ranks, {"num_rays": 1})
    except ConfigError as error:
        return str(error)
    return ""


def rows(ranks: Ranks, count: int) -> list[int]:
    """Return which rows of a batch of `count` are a rank's, as it draws them."""
    pixels = TrainingPixels(SCENE, tiny().pixels, torch.device("cpu"))
    with divided_among(ranks):
        own = pixels.draw(count, torch.Generator().manual_seed(3))
    whole = pixels.draw(count - count % ranks.count, torch.Generator().manual_seed(3))
    same = (own.rays.directions[:, None] == whole.rays.directions[None]).all(dim=-1)
    return same.int().argmax(dim=-1).tolist()
