"""The polish of a trained model: elements, tables, materials and light in turns, then the networks."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.data.ray_batches import TrainingPixels
from flashcache.fields.materials import Materials
from flashcache.physical.model import InverseModel
from flashcache.polish.elements import Elements, find_elements
from flashcache.polish.grey_card import Card, settle_by_card
from flashcache.polish.incoming import SIDE, incoming_tables
from flashcache.polish.light import Prediction, fit_light
from flashcache.polish.materials import choose
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.normals import plane_normals
from flashcache.polish.octahedron import octahedral_directions
from flashcache.polish.write import write_environments, write_materials, write_normals
from flashcache.randomness import generator_for

STAGE = "polish"
LEAST_ELEMENTS = 200
MOST_LIGHTS = 4
ROUNDS = 2
"""Times that the light is fitted."""
FINER = 2
"""Cells of an environment along a side, per cell of the tables."""
LIGHT_STEPS, LIGHT_RATE, LIGHT_OUTLIER, LIGHT_TETHER = 40, 0.15, 0.05, 1e-2
SAME_NORMAL = 0.9999
"""Cosine from which a normal is the predicted one."""
NUM_PARTS = 5 + ROUNDS


@dataclass(frozen=True, slots=True)
class PolishReport:
    """What the polish did."""

    kept: str = ""
    """Why stage two's result was kept; empty where it was changed."""
    values: dict[str, float] = field(default_factory=dict)
    """Sizes and errors, for the log."""
    findings: tuple[tuple[str, str], ...] = ()
    """Code and message of what the user should know."""


def polish(
    model: InverseModel,
    pixels: TrainingPixels,
    *,
    seed: int,
    card: Card | None = None,
    advance: Callable[[int], None] = lambda part: None,
) -> PolishReport:
    """Fit materials, light and normals to the photographs, and write them into `model`.

    `advance` is called with the number of parts that are done, of `NUM_PARTS`; it may raise to end the
    polish, which leaves the model as it was until the last part. With a `card`, albedo and light are brought
    to what it reflects. Beyond the paper.
    """
    if model.environment.turns is not None:
        return PolishReport("the light turns from photograph to photograph")
    num_lights = len(model.domain.lights)
    if num_lights > MOST_LIGHTS:
        return PolishReport(f"there are {num_lights} lights, and at most {MOST_LIGHTS} are taken together")
    generator = generator_for(seed, STAGE, 0, "elements", pixels.device)
    with torch.no_grad():
        elements = find_elements(model, pixels, generator)
        if len(elements) < LEAST_ELEMENTS:
            return PolishReport(f"only {len(elements)} pieces of surface are seen by two photographs")
        advance(1)
        tables = incoming_tables(model, elements, num_lights)
        advance(2)
        sky = environments(model, num_lights)
        trained = _joined(model, elements)
        neighbours = Neighbours.of(elements)
        normal = plane_normals(elements)
        values = {"elements": float(len(elements)), "observations": float(len(elements.colour))}
        learned = not model.environment.known and not model.environment.rotations
        for number in range(ROUNDS + 1):
            found = choose(elements, tables, sky, normal, trained, neighbours)
            advance(3 + number)
            if not learned:
                break
            prediction = Prediction(elements, tables, found.reflectance, SIDE * FINER)
            sky, before, after = fit_light(
                prediction,
                sky,
                steps=LIGHT_STEPS,
                rate=LIGHT_RATE,
                outlier=LIGHT_OUTLIER,
                tether=LIGHT_TETHER,
            )
            values |= {f"light_before_{number}": before, f"light_after_{number}": after}
    reflectance = found.reflectance
    findings: tuple[tuple[str, str], ...] = ()
    if card is not None:
        # Last, so that it holds whatever the fit has done; what photographs show hardly changes.
        settled = settle_by_card(model, card, elements.positions, elements.size, reflectance.albedo, sky)
        reflectance, sky = replace(reflectance, albedo=settled.albedo), settled.sky
        values, findings = values | settled.values, settled.findings
    metal = reflectance.metalness > 0.5
    values["metal_share"] = float(metal.float().mean())
    changed = (reflectance.normal * elements.normal).sum(dim=-1) < SAME_NORMAL
    values["turned_share"] = float(changed.float().mean())
    values["width_gain"] = float(found.gain.mean())
    if not all(bool(torch.isfinite(part).all()) for part in (*_parts(reflectance), sky)):
        return PolishReport("a fitted value is not finite", values)
    write_materials(model, elements, reflectance, generator)
    advance(NUM_PARTS - 1)
    write_normals(model, elements, reflectance.normal, changed, generator)
    if learned or card is not None:
        write_environments(model, sky)
    advance(NUM_PARTS)
    return PolishReport("", values, findings)


def environments(model: InverseModel, num_lights: int) -> Float[Tensor, "lights cells 3"]:
    """Return the radiance of the model's environments in a square of `FINER` times the tables' cells."""
    device = next(model.parameters()).device
    directions = octahedral_directions(SIDE * FINER).to(device)
    index = torch.zeros(len(directions), dtype=torch.long, device=device)
    return torch.stack([model.environment(directions, index + light) for light in range(num_lights)])


def _joined(model: InverseModel, elements: Elements) -> Materials:
    parts = [model.materials(part) for part in elements.positions.split(1 << 14)]
    return Materials(
        *(torch.cat([getattr(part, name) for part in parts]) for name in ("albedo", "alpha", "metalness"))
    )


def _parts(reflectance: object) -> list[Tensor]:
    return [getattr(reflectance, name) for name in ("albedo", "alpha", "metalness", "normal")]
