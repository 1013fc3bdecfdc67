"""Scores the environments that were recovered against the true ones, where those are known.

Maps are latitude-longitude pictures of linear radiance, z up, reduced to `ROWS` x `COLUMNS` pixels by area.
"""

from dataclasses import dataclass

import numpy as np
import torch
from flashcache.geometry.directions import environment_directions, environment_solid_angles
from jaxtyping import Float
from lambent_relight.environment.area_mean import area_mean
from numpy import ndarray

from lambent_run.report.predictions import save_array
from lambent_run.report.request import Subject
from lambent_run.report.table import Table

ROWS, COLUMNS = 32, 64
FINE = 4
"""Rows of a recovered environment per row of the comparison."""
FLOOR = 0.01
"""Radiance below this share of a channel's mean counts as this: such light hardly shows in a photograph."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
FOLDER = "environments"

Map = Float[ndarray, "rows columns 3"]


@dataclass(frozen=True, slots=True)
class EnvironmentErrors:
    """How a recovered environment differs from the true one."""

    log_rmse: float
    """Root mean square over directions and channels of the difference in log radiance, after one factor per
    channel."""
    log_rmse_unscaled: float
    peak_ratio: float
    """Luminance of the brightest pixel over that of the true map, after the factors."""
    peak_ratio_unscaled: float
    peak_angle_deg: float | None
    """Between the brightest pixels' directions; None where the true map has no brightest one."""
    factor: tuple[float, float, float]
    """From recovered to true radiance: the one per channel that makes the first figure smallest."""


def compare_environments(recovered: Map, truth: Map) -> EnvironmentErrors:
    """Return the errors of `recovered`; both maps have at least `ROWS` x `COLUMNS` pixels."""
    own, wanted = reduced(recovered), reduced(truth)
    weight = np.repeat(environment_solid_angles(ROWS, COLUMNS, torch.float64).numpy(), COLUMNS) / (4 * np.pi)
    apart = _log_radiance(own, weight) - _log_radiance(wanted, weight)
    shift = weight @ apart
    factor = np.exp(-shift)
    scaled = own * factor
    peak = (wanted @ LUMINANCE).max()
    brightest = None
    if np.ptp(wanted @ LUMINANCE) > 0.0:
        directions = environment_directions(ROWS, COLUMNS, torch.float64).reshape(-1, 3).numpy()
        a, b = (directions[int((each @ LUMINANCE).argmax())] for each in (scaled, wanted))
        brightest = float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
    return EnvironmentErrors(
        log_rmse=float(np.sqrt((weight @ np.square(apart - shift)).mean())),
        log_rmse_unscaled=float(np.sqrt((weight @ np.square(apart)).mean())),
        peak_ratio=float((scaled @ LUMINANCE).max() / peak),
        peak_ratio_unscaled=float((own @ LUMINANCE).max() / peak),
        peak_angle_deg=brightest,
        factor=(float(factor[0]), float(factor[1]), float(factor[2])),
    )


def reduced(image: Map) -> Float[ndarray, "pixels 3"]:
    """Return a map's means over the pixels of the comparison, row by row."""
    return area_mean(image, ROWS, COLUMNS).reshape(-1, 3)


def _log_radiance(pixels: Float[ndarray, "pixels 3"], weight: Float[ndarray, " pixels"]) -> ndarray:
    # The floor is the map's own: a map of another brightness differs from this one by its factor and no more.
    floor = np.maximum(FLOOR * (weight @ pixels), 1e-8)
    return np.log(np.maximum(pixels, floor))


def scored_lights(subject: Subject) -> tuple[str, ...]:
    """Return the training lights whose recovered environment can be compared.

    Those that were learned and whose true map is there; of lights that are one environment turned, the first;
    none where the light turned from photograph to photograph, for the truth says nothing about its turns.
    """
    if subject.scene.turned:
        return ()
    lights = subject.scene.lights[:1] if subject.shared_light else subject.scene.lights
    return tuple(
        light for light in lights if light in subject.true_lights and light not in subject.known_lights
    )


def score_environments(table: Table, subject: Subject) -> None:
    """Note the errors of the recovered environments, and save both maps below `environments/`.

    Figures without the name of a light are means over the lights; one light alone has no others.
    """
    for light in scored_lights(subject):
        index = subject.scene.lights.index(light)
        recovered = subject.model.environment.image(FINE * ROWS, index).cpu().numpy()
        truth = subject.true_lights[light]
        for name, image in ((light, recovered), (f"{light}_true", truth)):
            save_array(subject.out / FOLDER / f"{name}.npy", area_mean(image, ROWS, COLUMNS))
        errors = compare_environments(recovered, truth)
        names = ["environment"]
        if len(subject.scene.lights) > 1 and not subject.shared_light:
            names.append(f"environment/{light}")
        for name in names:
            table.add(f"{name}/log_rmse", errors.log_rmse)
            table.add(f"{name}/log_rmse_unscaled", errors.log_rmse_unscaled)
            table.add(f"{name}/peak_ratio", errors.peak_ratio)
            table.add(f"{name}/peak_ratio_unscaled", errors.peak_ratio_unscaled)
            if errors.peak_angle_deg is not None:
                table.add(f"{name}/peak_angle", errors.peak_angle_deg)
