"""Note to users about the factor per channel that photographs under unknown light leave open."""

import torch
from flashcache.geometry.directions import environment_solid_angles
from flashcache.physical.model import InverseModel
from lambent_core.measured import measured

from lambent_run.report.request import Subject

CODE = "albedo.common_factor"
ROWS = 32


def light_colour(model: InverseModel, light: int) -> tuple[float, float, float]:
    """Return a recovered light's mean radiance over all directions, relative to its green."""
    image = model.environment.image(ROWS, light).double().cpu()
    angles = environment_solid_angles(ROWS, 2 * ROWS, torch.float64)
    mean = (image * angles[:, None, None]).sum(dim=(0, 1))
    red, green, blue = (mean / mean[1].clamp_min(1e-12)).tolist()
    return red, green, blue


def common_factor_note(subject: Subject) -> str | None:
    """Return what is open, when it matters and what settles it; None where a card or a known light did."""
    if subject.grey_card or subject.known_lights:
        return None
    colours = []
    lights = subject.scene.lights[:1] if subject.shared_light else subject.scene.lights
    for number, light in enumerate(lights):
        red, green, blue = light_colour(subject.model, number)
        colours.append(f"{light} {measured(red, 2)} : {measured(green)} : {measured(blue, 2)}")
    several = " Several lights that are learned do not settle it." if len(subject.scene.lights) > 1 else ""
    return (
        "Photographs under a light that is not known tell albedo from light only up to one factor per "
        f"channel. The recovered light is on average {', '.join(colours)} (red : green : blue); if it was "
        "white in truth, all albedo is off by the inverse of that. It matters where the object is shown "
        "beside others under new light, or its albedo is used as it is. A small grey card on the object in "
        f"one photograph (--grey-card) or a known environment (--known-light) settles it.{several}"
    )
