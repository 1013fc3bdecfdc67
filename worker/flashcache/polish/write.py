"""The polished values as networks: material field and normals learn what elements hold."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from flashcache.fields.materials import MaterialField
from flashcache.geometry.directions import dot
from flashcache.physical.model import InverseModel
from flashcache.polish.elements import Elements
from flashcache.polish.light import Reflectance
from flashcache.polish.materials import GAMMA

BATCH = 8192


@dataclass(frozen=True, slots=True)
class Lesson:
    """How long normals are taught."""

    steps: int
    rate: float


MATERIAL_STEPS, MATERIAL_RATE = 300, 1e-2
FIRST, AGAIN = Lesson(150, 4e-3), Lesson(60, 4e-3)
"""The second where nearly the same normals were learned before."""
FINAL_RATE = 0.03
PULSE_STEPS = 50
"""About a second on two cores."""
MOST_REST = 0.25
"""Largest share of a batch for what no element covers."""
ASIDE = 0.3
"""Standard deviation by which places are moved, in sizes of an element."""


def write_materials(
    model: InverseModel,
    elements: Elements,
    reflectance: Reflectance,
    generator: torch.Generator,
    factor: Float[Tensor, "3"] | None = None,
    pulse: Callable[[], None] = lambda: None,
) -> None:
    """Replace the material field by one that is taught `reflectance` at the observed points.

    It begins afresh: what the trained one holds beyond the elements' values is grain. Where opaque pixels
    have no observation, it is taught what the trained one has there, with its albedo times `factor`.
    `pulse` is called every `PULSE_STEPS`.
    """
    device = elements.positions.device
    field = _fresh_field(model, generator).to(device)
    element = elements.element
    wanted = (reflectance.albedo[element] * elements.detail).clamp(0.004, 0.996).pow(GAMMA)
    alpha = reflectance.alpha.clamp(1e-3, 0.996)[element, None].sqrt()
    metal = reflectance.metalness.clamp(0.004, 0.996)[element, None]
    scale = torch.ones(3, device=device) if factor is None else factor
    rest = elements.rest.reshape(-1, 3)
    known = [model.materials(part) for part in rest.split(1 << 14)]
    of_rest_targets = [
        (torch.cat([each.albedo for each in known]) * scale).clamp(0.004, 0.996).pow(GAMMA),
        torch.cat([each.alpha.sqrt() for each in known]),
        torch.cat([each.metalness for each in known]),
    ]
    of_rest = round(BATCH * min(MOST_REST, len(rest) / (len(rest) + elements.places[..., 0].numel())))

    def loss() -> Tensor:
        drawn = torch.randint(len(element), (BATCH - of_rest,), generator=generator, device=device)
        places = _places(elements, drawn, generator)
        targets = [wanted[drawn], alpha[drawn], metal[drawn]]
        if of_rest:
            others = torch.randint(len(rest), (of_rest,), generator=generator, device=device)
            targets = [
                torch.cat([own, far[others]]) for own, far in zip(targets, of_rest_targets, strict=True)
            ]
            places = torch.cat([places, rest[others]])
        materials = field(places)
        values = (materials.albedo.pow(GAMMA), materials.alpha.sqrt(), materials.metalness)
        return torch.stack([(a - b).abs().mean() for a, b in zip(values, targets, strict=True)]).sum()

    _learn(field, loss, MATERIAL_STEPS, MATERIAL_RATE, pulse)
    model.materials.load_state_dict(field.state_dict())


def _fresh_field(model: InverseModel, generator: torch.Generator) -> MaterialField:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator.initial_seed())
        return MaterialField(model.config.materials, model.domain.contraction_radius)


def write_normals(
    model: InverseModel,
    elements: Elements,
    normal: Float[Tensor, "elements 3"],
    changed: Tensor,
    generator: torch.Generator,
    lesson: Lesson = FIRST,
    pulse: Callable[[], None] = lambda: None,
) -> None:
    """Teach the predicted normals `normal` at elements that are `changed`, and their own everywhere else.

    `pulse` is called every `PULSE_STEPS`.
    """
    moved, kept = ((changed == flag)[elements.element].nonzero()[:, 0] for flag in (True, False))
    if not len(moved):
        return
    field, device = model.nerf.normals, normal.device
    others = torch.cat([elements.places[kept].reshape(-1, 3), elements.rest.reshape(-1, 3)])
    half = BATCH // 2 if len(others) else BATCH

    def teaching() -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        for _ in range(lesson.steps):
            drawn = moved[torch.randint(len(moved), (half,), generator=generator, device=device)]
            places, target = _places(elements, drawn, generator), normal[elements.element[drawn]]
            if len(others):
                number = torch.randint(len(others), (BATCH - half,), generator=generator, device=device)
                of_others = others[number]
                places = torch.cat([places, of_others])
                target = torch.cat([target, field(of_others, model.nerf.density(of_others).hidden)])
            yield places, model.nerf.density(places).hidden, target

    # All batches are made before the field moves: others keep the normals that they have now.
    with torch.no_grad():
        batches = list(teaching())
    remaining = iter(batches)

    def loss() -> Tensor:
        places, hidden, target = next(remaining)
        return (1.0 - dot(field(places, hidden), target)).mean()

    _learn(field, loss, lesson.steps, lesson.rate, pulse)


def _places(
    elements: Elements, drawn: Int[Tensor, " batch"], generator: torch.Generator
) -> Float[Tensor, "batch 3"]:
    """Return one place of the rays of each of the observations `drawn`, moved a little."""
    device = elements.places.device
    which = torch.randint(elements.places.shape[1], drawn.shape, generator=generator, device=device)
    aside = torch.randn(len(drawn), 3, generator=generator, device=device)
    return elements.places[drawn, which] + ASIDE * elements.size * aside


def _learn(
    part: nn.Module, loss: Callable[[], Tensor], steps: int, rate: float, pulse: Callable[[], None]
) -> None:
    """Take Adam's steps on the parameters of `part`, with a rate that falls to `FINAL_RATE` of it."""
    part.requires_grad_(True)
    optimiser = torch.optim.Adam(part.parameters(), lr=rate, betas=(0.9, 0.99), eps=1e-15)
    with torch.enable_grad():
        for step in range(steps):
            for group in optimiser.param_groups:
                group["lr"] = rate * FINAL_RATE ** (step / steps)
            optimiser.zero_grad()
            loss().backward()
            optimiser.step()
            if step % PULSE_STEPS == 0:
                pulse()
    part.requires_grad_(False)
