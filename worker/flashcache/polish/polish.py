"""The polish of a trained model: elements, tables, materials and light in turns, then the networks."""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.data.ray_batches import TrainingPixels
from flashcache.fields.materials import Materials
from flashcache.geometry.octahedron import octahedral_directions
from flashcache.physical.model import InverseModel
from flashcache.polish.confidence import Confidence, confidence_of
from flashcache.polish.correction import corrected_albedo
from flashcache.polish.elements import Elements, find_elements
from flashcache.polish.gate import LEAST_SHARE, STAGE, blended, gate, rendered
from flashcache.polish.grey_card import Card, settle_by_card
from flashcache.polish.incoming import SIDE, incoming_tables
from flashcache.polish.known_light import judge_by_elements
from flashcache.polish.light import Prediction, Reflectance, fit_light
from flashcache.polish.materials import choose, smoothed_albedo
from flashcache.polish.neighbours import Neighbours
from flashcache.polish.normals import plane_normals
from flashcache.polish.write import AGAIN, FIRST, write_materials, write_normals
from flashcache.randomness import generator_for

LEAST_ELEMENTS = 200
MOST_LIGHTS = 4
MOST_CLIPPED = 0.9
"""Share of clipped channels above which nothing is fitted."""
ROUNDS = 3
"""Times that materials are chosen and the light is fitted."""
WIDE_REACH, WIDE_MOST = 9.0, 150
"""Of the larger planes whose normals are tried: surfaces of mirrors come out bumpy."""
FINER = 2
"""Cells of an environment along a side, per cell of the tables."""
LIGHT_STEPS, LIGHT_RATE, LIGHT_OUTLIER, LIGHT_TETHER = 40, 0.15, 0.15, 1e-2
SAME_NORMAL = 0.9999
"""Cosine from which a normal is the predicted one."""
NUM_PARTS = 6 + ROUNDS


@dataclass(frozen=True, slots=True)
class PolishReport:
    """What the polish did."""

    kept: str = ""
    """Why stage two's result was kept; empty where it was changed."""
    values: dict[str, float] = field(default_factory=dict)
    """Sizes and errors, for the log."""
    findings: tuple[tuple[str, str], ...] = ()
    """Code and message of what the user should know."""
    confidence: Confidence | None = None
    """How sure the elements' materials are; None where stage two's are kept."""


@dataclass(frozen=True, slots=True, eq=False)
class _Written:
    """A model that has learned the elements' materials, and the normals that it has learned."""

    model: InverseModel
    normal: Float[Tensor, "elements 3"]


def polish(
    model: InverseModel,
    pixels: TrainingPixels,
    *,
    seed: int,
    card: Card | None = None,
    advance: Callable[[int], None] = lambda part: None,
    pulse: Callable[[], None] = lambda: None,
) -> PolishReport:
    """Fit materials, light and normals to the photographs, and write them into `model`.

    `advance` is called with the number of parts that are done, of `NUM_PARTS`, and `pulse` every few seconds
    inside the long ones; both may raise to end the polish, which leaves the model as it was until the last
    part. With a `card`, albedo and light are brought to what it reflects. Beyond the paper.
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
            return PolishReport(
                f"only {len(elements)} pieces of surface are seen by two photographs; take more, nearer to "
                "each other"
            )
        if float(elements.clipped.float().mean()) > MOST_CLIPPED:
            return PolishReport(
                "nearly all pixels are clipped and say only that it was bright; expose the photographs less"
            )
        advance(1)
        tables = incoming_tables(model, elements, num_lights)
        advance(2)
        sky = environments(model, num_lights)
        trained = _joined(model, elements)
        neighbours = Neighbours.of(elements)
        seen, checks = elements.split()
        normals = [plane_normals(elements), plane_normals(elements, WIDE_REACH, WIDE_MOST)]
        values = {"elements": float(len(elements)), "observations": float(len(elements.colour))}
        learned = not model.environment.known and not model.environment.rotations
        for number in range(ROUNDS if learned else 1):
            reflectance = choose(seen, tables, sky, normals, trained, neighbours)
            pulse()
            if learned:
                prediction = Prediction(seen, tables, reflectance, SIDE * FINER)
                sky, before, after = _refitted(prediction, sky)
                values |= {f"light_before_{number}": before, f"light_after_{number}": after}
            advance(3 + number)
    if not all(bool(torch.isfinite(part).all()) for part in (*_parts(reflectance), sky)):
        return PolishReport("a fitted value is not finite", values)
    if model.environment.known and not model.environment.rotations:
        verdict = judge_by_elements(
            seen,
            tables,
            sky,
            reflectance,
            neighbours,
            known=model.environment.known,
            refit=lambda prediction: _refitted(prediction, sky)[0],
        )
        values |= {"known_light_error": verdict.error}
        if verdict.contradicted:
            return PolishReport("the photographs contradict the known light", values, verdict.findings)
    light = sky if learned else None
    written = _written(model, elements, reflectance, light, generator, pulse=pulse)
    advance(NUM_PARTS - 3)
    with torch.no_grad():
        render = partial(rendered, written.model, pixels, seed=seed)
        reflectance = corrected_albedo(render, seen, reflectance, neighbours, seed)
    written = _written(model, elements, reflectance, light, generator, before=written, pulse=pulse)
    advance(NUM_PARTS - 2)
    with torch.no_grad():
        kept = gate(model, written.model, pixels, checks, neighbours, seed)
    share = float(kept.share.mean())
    values |= {"error_before": kept.before, "error_fitted": kept.fitted, "fitted_share": share}
    if share < LEAST_SHARE:
        return PolishReport("unseen photographs are explained better without it", values)
    advance(NUM_PARTS - 1)
    if share < 1.0:
        stage_two = Reflectance(
            smoothed_albedo(elements, trained, neighbours),
            trained.alpha[:, 0],
            trained.metalness[:, 0],
            elements.normal,
        )
        reflectance = blended(stage_two, reflectance, kept.share)
    findings: tuple[tuple[str, str], ...] = ()
    factor = None
    if card is not None:
        # Last, so that it holds whatever the fit has done; what photographs show hardly changes.
        settled = settle_by_card(model, card, elements.positions, elements.size, reflectance.albedo, sky)
        reflectance, sky = replace(reflectance, albedo=settled.albedo), settled.sky
        values, findings, factor = values | settled.values, settled.findings, settled.factor
    if share < 1.0 or factor is not None:
        light = sky if learned or factor is not None else None
        written = _written(model, elements, reflectance, light, generator, factor, written, pulse=pulse)
    values["metal_share"] = float((reflectance.metalness > 0.5).float().mean())
    confidence = confidence_of(seen, tables, sky, reflectance, neighbours)
    model.load_state_dict(written.model.state_dict())
    advance(NUM_PARTS)
    return PolishReport("", values, findings, confidence)


def _refitted(
    prediction: Prediction, sky: Float[Tensor, "lights cells 3"]
) -> tuple[Float[Tensor, "lights cells 3"], float, float]:
    """Return the light that explains the photographs best, from `sky` on, and the loss before and after."""
    return fit_light(
        prediction,
        sky,
        steps=LIGHT_STEPS,
        rate=LIGHT_RATE,
        outlier=LIGHT_OUTLIER,
        tether=LIGHT_TETHER,
    )


def _written(
    model: InverseModel,
    elements: Elements,
    reflectance: Reflectance,
    sky: Float[Tensor, "lights cells 3"] | None,
    generator: torch.Generator,
    factor: Float[Tensor, "3"] | None = None,
    before: _Written | None = None,
    *,
    pulse: Callable[[], None] = lambda: None,
) -> _Written:
    """Return a copy of the model that has learned materials and normals of elements, and the light `sky`.

    Normals go on from `before`, which are nearly these, and take less time.
    """
    polished = copy.deepcopy(model)
    normal, lesson = elements.normal, FIRST
    if before is not None:
        normal, lesson = before.normal, AGAIN
        polished.nerf.normals.load_state_dict(before.model.nerf.normals.state_dict())
    write_materials(polished, elements, reflectance, generator, factor, pulse)
    changed = (reflectance.normal * normal).sum(dim=-1) < SAME_NORMAL
    write_normals(polished, elements, reflectance.normal, changed, generator, lesson, pulse)
    if sky is not None:
        polished.environment.set_texture(sky)
    return _Written(polished, reflectance.normal)


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
