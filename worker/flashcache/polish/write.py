"""The polished values as networks: material field, normals and environments learn what elements hold."""

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float
from torch import Tensor, nn

from flashcache.fields.materials import MaterialField
from flashcache.geometry.directions import dot
from flashcache.physical.model import InverseModel
from flashcache.polish.elements import Elements
from flashcache.polish.light import Reflectance
from flashcache.polish.octahedron import octahedral_directions

BATCH = 8192
MATERIAL_STEPS, NORMAL_STEPS, LIGHT_STEPS = 300, 150, 400
MATERIAL_RATE, NORMAL_RATE, LIGHT_RATE = 1e-2, 4e-3, 3e-3
FINAL_RATE = 0.03
ABOVE = 0.6
"""Standard deviation of how far from the surface values are taught, in sizes of an element: rays see through
a layer about as thick."""
GAMMA = 1.0 / 2.2


def write_materials(
    model: InverseModel, elements: Elements, found: Reflectance, generator: torch.Generator
) -> None:
    """Replace the material field by one that is taught `found` at the observed points.

    It begins afresh: what the trained one holds beyond the elements' values is grain.
    """
    config = model.config.materials
    device = elements.positions.device
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(generator.initial_seed())
        field = MaterialField(config, model.domain.contraction_radius).to(device)
    element = elements.element
    wanted = (found.albedo[element] * elements.detail).clamp(0.004, 0.996).pow(GAMMA)
    alpha = found.alpha.clamp(1e-3, 0.996)[element, None].sqrt()
    metal = found.metalness.clamp(0.004, 0.996)[element, None]
    normal = found.normal[element]

    def loss() -> Tensor:
        drawn = torch.randint(len(element), (BATCH,), generator=generator, device=device)
        away = ABOVE * elements.size * torch.randn(BATCH, 1, generator=generator, device=device)
        materials = field(elements.points[drawn] + away * normal[drawn])
        return (
            (materials.albedo.pow(GAMMA) - wanted[drawn]).abs().mean()
            + (materials.alpha.sqrt() - alpha[drawn]).abs().mean()
            + (materials.metalness - metal[drawn]).abs().mean()
        )

    _learn(field, loss, MATERIAL_STEPS, MATERIAL_RATE)
    model.materials.load_state_dict(field.state_dict())


def write_normals(
    model: InverseModel,
    elements: Elements,
    normal: Float[Tensor, "elements 3"],
    changed: Tensor,
    generator: torch.Generator,
) -> None:
    """Teach the predicted normals `normal` at elements that are `changed`, and their own at all others."""
    moved, kept = changed.nonzero()[:, 0], (~changed).nonzero()[:, 0]
    if not len(moved):
        return
    field, device = model.nerf.normals, normal.device
    half = BATCH // 2 if len(kept) else BATCH

    def points(among: Tensor, count: int) -> tuple[Tensor, Tensor]:
        drawn = among[torch.randint(len(among), (count,), generator=generator, device=device)]
        away = ABOVE * elements.size * torch.randn(count, 1, generator=generator, device=device)
        aside = 0.3 * elements.size * torch.randn(count, 3, generator=generator, device=device)
        return drawn, elements.positions[drawn] + away * elements.normal[drawn] + aside

    def teaching() -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        for _ in range(NORMAL_STEPS):
            drawn, places = points(moved, half)
            hidden = model.nerf.density(places).hidden
            target = normal[drawn]
            if len(kept):
                _, others = points(kept, BATCH - half)
                of_others = model.nerf.density(others).hidden
                target = torch.cat([target, field(others, of_others)])
                places, hidden = torch.cat([places, others]), torch.cat([hidden, of_others])
            yield places, hidden, target

    # All batches are made before the field moves: others keep the normals that they have now.
    with torch.no_grad():
        batches = list(teaching())
    remaining = iter(batches)

    def loss() -> Tensor:
        places, hidden, target = next(remaining)
        return (1.0 - dot(field(places, hidden), target)).mean()

    _learn(field, loss, NORMAL_STEPS, NORMAL_RATE)


def write_environments(model: InverseModel, sky: Float[Tensor, "lights cells 3"]) -> None:
    """Teach the environments that are learned the radiance `sky`."""
    network = model.environment
    side = round(sky.shape[1] ** 0.5)
    directions = octahedral_directions(side).to(sky.device)
    learned = network.learned_lights

    def loss() -> Tensor:
        total = sky.new_zeros(())
        for light in learned.tolist():
            index = torch.full((len(directions),), light, dtype=torch.long, device=sky.device)
            now = network(directions, index)
            total = total + ((now + 0.03).log() - (sky[light] + 0.03).log()).square().mean()
            total = total + 0.2 * (now - sky[light]).abs().mean() / sky[light].mean()
        return total

    if len(learned):
        _learn(network, loss, LIGHT_STEPS, LIGHT_RATE)


def _learn(part: nn.Module, loss: Callable[[], Tensor], steps: int, rate: float) -> None:
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
    part.requires_grad_(False)
