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
from flashcache.polish.incoming import SIDE, IncomingTables, incoming_tables
from flashcache.polish.known_light import KnownLightVerdict, judge_by_elements
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


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """The elements, and what stays the same while materials and light are fitted."""

    elements: Elements
    seen: Elements
    """With the photographs of the fit."""
    checks: Elements
    """With those that are held out."""
    tables: IncomingTables
    trained: Materials
    """Stage two's."""
    neighbours: Neighbours

    def stage_two(self) -> Reflectance:
        """Return what stage two has found, without grain."""
        trained = self.trained
        albedo = smoothed_albedo(self.elements, trained, self.neighbours)
        return Reflectance(albedo, trained.alpha[:, 0], trained.metalness[:, 0], self.elements.normal)


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
    if refusal := _refusal(model):
        return PolishReport(refusal)
    generator = generator_for(seed, STAGE, 0, "elements", pixels.device)
    # 1. The surface as elements, with what arrives at each of them.
    with torch.no_grad():
        elements = find_elements(model, pixels, generator)
        if refusal := _shortage(elements):
            return PolishReport(refusal)
        advance(1)
        surface = _surface(model, elements)
        advance(2)
        # 2. Materials and light in turns, by photographs that are not held out.
        reflectance, sky, values = _fitted(model, surface, advance, pulse)
    if not all(bool(torch.isfinite(part).all()) for part in (*_parts(reflectance), sky)):
        return PolishReport("a fitted value is not finite", values)
    if verdict := _verdict(model, surface, reflectance, sky):
        values |= {"known_light_error": verdict.error}
        if verdict.contradicted:
            return PolishReport("the photographs contradict the known light", values, verdict.findings)
    seen, neighbours, learned = surface.seen, surface.neighbours, _learns_light(model)
    # 3. Networks learn both, and albedo is corrected by what pixels of these networks show.
    light = sky if learned else None
    written = _written(model, elements, reflectance, light, generator, pulse=pulse)
    advance(NUM_PARTS - 3)
    with torch.no_grad():
        render = partial(rendered, written.model, pixels, seed=seed)
        reflectance = corrected_albedo(render, seen, reflectance, neighbours, seed)
    written = _written(model, elements, reflectance, light, generator, before=written, pulse=pulse)
    advance(NUM_PARTS - 2)
    # 4. Elements fall back to stage two where photographs that were held out contradict the fit.
    with torch.no_grad():
        kept = gate(model, written.model, pixels, surface.checks, neighbours, seed)
    share = float(kept.share.mean())
    values |= {"error_before": kept.before, "error_fitted": kept.fitted, "fitted_share": share}
    if share < LEAST_SHARE:
        return PolishReport("unseen photographs are explained better without it", values)
    advance(NUM_PARTS - 1)
    if share < 1.0:
        reflectance = blended(surface.stage_two(), reflectance, kept.share)
    # 5. The card comes last, so that it holds whatever the fit has done; photographs look hardly different.
    settled = settle_by_card(model, card, elements.positions, elements.size, reflectance.albedo, sky)
    reflectance, sky, factor = replace(reflectance, albedo=settled.albedo), settled.sky, settled.factor
    if share < 1.0 or factor is not None:
        light = sky if learned or factor is not None else None
        written = _written(model, elements, reflectance, light, generator, factor, written, pulse=pulse)
    values |= settled.values | {"metal_share": float((reflectance.metalness > 0.5).float().mean())}
    confidence = confidence_of(seen, surface.tables, sky, reflectance, neighbours)
    model.load_state_dict(written.model.state_dict())
    advance(NUM_PARTS)
    return PolishReport("", values, settled.findings, confidence)


def _refusal(model: InverseModel) -> str:
    """Return why a model is not polished; empty for one that is."""
    num_lights = len(model.domain.lights)
    if model.environment.turns is not None:
        return "the light turns from photograph to photograph"
    if num_lights > MOST_LIGHTS:
        return f"there are {num_lights} lights, and at most {MOST_LIGHTS} are taken together"
    return ""


def _shortage(elements: Elements) -> str:
    """Return why photographs show too little of a surface to fit anything; empty where they show enough."""
    if len(elements) < LEAST_ELEMENTS:
        return (
            f"only {len(elements)} pieces of surface are seen by two photographs; take more, nearer to each "
            "other"
        )
    if float(elements.clipped.float().mean()) > MOST_CLIPPED:
        return "nearly all pixels are clipped and say only that it was bright; expose the photographs less"
    return ""


def _verdict(
    model: InverseModel, surface: _Surface, reflectance: Reflectance, sky: Float[Tensor, "lights cells 3"]
) -> KnownLightVerdict | None:
    """Return whether photographs contradict the lights that are given; None where none is, or all turn."""
    known = model.environment.known
    if not known or model.environment.rotations:
        return None
    return judge_by_elements(
        surface.seen,
        surface.tables,
        sky,
        reflectance,
        surface.neighbours,
        known=known,
        refit=lambda prediction: _refitted(prediction, sky)[0],
    )


def _learns_light(model: InverseModel) -> bool:
    return not model.environment.known and not model.environment.rotations


def _surface(model: InverseModel, elements: Elements) -> _Surface:
    tables = incoming_tables(model, elements, len(model.domain.lights))
    return _Surface(elements, *elements.split(), tables, _joined(model, elements), Neighbours.of(elements))


def _fitted(
    model: InverseModel, surface: _Surface, advance: Callable[[int], None], pulse: Callable[[], None]
) -> tuple[Reflectance, Float[Tensor, "lights cells 3"], dict[str, float]]:
    """Return materials and light that explain the photographs of the fit, with numbers for the log.

    A light that is given stays as it is, and materials are chosen once.
    """
    elements, seen = surface.elements, surface.seen
    sky = environments(model, len(model.domain.lights))
    normals = [plane_normals(elements), plane_normals(elements, WIDE_REACH, WIDE_MOST)]
    values = {"elements": float(len(elements)), "observations": float(len(elements.colour))}
    learned = _learns_light(model)
    for number in range(ROUNDS if learned else 1):
        reflectance = choose(seen, surface.tables, sky, normals, surface.trained, surface.neighbours)
        pulse()
        if learned:
            prediction = Prediction(seen, surface.tables, reflectance, SIDE * FINER)
            sky, before, after = _refitted(prediction, sky)
            values |= {f"light_before_{number}": before, f"light_after_{number}": after}
        advance(3 + number)
    return reflectance, sky, values


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

    Normals continue from `before`, which are nearly these, and take less time.
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
