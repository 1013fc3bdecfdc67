"""The environments, fitted to all observations while reflectance stays fixed."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from flashcache.geometry.octahedron import octahedral_directions, octahedral_solid_angles
from flashcache.kernels.cpu import over_rows
from flashcache.physical.brdf import DIELECTRIC_F0
from flashcache.polish import compiled_fit
from flashcache.polish.elements import Elements
from flashcache.polish.fit import BLOCK, NOISE_FLOOR, half_vectors
from flashcache.polish.incoming import IncomingTables

DIRECTIONS = 16
"""Half vectors per observation."""
ROWS = 4096
"""Observations whose part in a gradient is summed at once: sums do not depend on the number of threads."""


@dataclass(frozen=True, slots=True, eq=False)
class Reflectance:
    """One material and normal for each element."""

    albedo: Float[Tensor, "elements 3"]
    alpha: Float[Tensor, " elements"]
    metalness: Float[Tensor, " elements"]
    normal: Float[Tensor, "elements 3"]


def specular_sums(
    elements: Elements,
    tables: IncomingTables,
    normal: Float[Tensor, "elements 3"],
    alpha: Float[Tensor, " elements"],
    fine: int,
    directions: int,
    some: slice = slice(None),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the specular integrals of `some` observations as sums over the sky's cells.

    Places in a square of `fine` cells per side [observations, 4 directions], weights there [observations,
    4 directions, 2] of what F0 multiplies and of the rest, and what near surfaces add [observations, 2, 3].
    """
    element = elements.element[some]
    count = len(element)
    cells = np.zeros((count, 4 * directions), np.int32)
    weights = np.zeros((count, 4 * directions, 2), np.float32)
    constant = np.zeros((count, 2, 3), np.float32)
    given = (
        element, elements.first - (some.start or 0), elements.omega_o[some], elements.light[some], normal,
        alpha, half_vectors(directions),
    )  # fmt: skip
    arrays = tuple(np.ascontiguousarray(part.numpy()) for part in given)
    rest = (directions, tables.clear.numpy(), tables.near.numpy(), fine, cells, weights, constant)
    over_rows(compiled_fit.reflections, count, BLOCK, *arrays, *rest)
    return cells, weights, constant


class Prediction:
    """What elements send to their cameras, as a linear function of the environments' cells."""

    def __init__(
        self, elements: Elements, tables: IncomingTables, reflectance: Reflectance, fine: int
    ) -> None:
        """`fine` is the number of cells along each side of an environment's square."""
        self.element, self.elements = elements.element, elements
        self.light = np.ascontiguousarray(elements.light.numpy())
        self.cells, self.weights, constant = specular_sums(
            elements, tables, reflectance.normal, reflectance.alpha, fine, DIRECTIONS
        )
        metal = reflectance.metalness[:, None]
        albedo = reflectance.albedo[self.element] * elements.detail
        metal = metal[self.element]
        self.diffuse = ((1.0 - metal) * albedo).numpy()
        self.f0 = np.ascontiguousarray((DIELECTRIC_F0 * (1.0 - metal) + metal * albedo).numpy())
        side = math.isqrt(tables.clear.shape[1])
        cosine = (reflectance.normal @ octahedral_directions(side).T).clamp_min(0.0)
        cosine = cosine * (octahedral_solid_angles(side) / math.pi)
        self.received = (cosine * tables.clear).numpy()
        self.side, self.scale, self.fine = side, fine // side, fine
        self.near = np.stack([torch.einsum("nd,ndc->nc", cosine, near).numpy() for near in tables.near])
        self.constant = self.f0 * constant[:, 0] + constant[:, 1]
        self.lights = tables.near.shape[0]

    def __call__(self, sky: np.ndarray) -> np.ndarray:
        """Return the radiance [observations, 3] of every observation under `sky` [lights, cells, 3]."""
        sky = np.ascontiguousarray(sky, np.float32)
        radiance = np.empty_like(self.constant)
        arrays = (self.cells, self.weights, self.f0, self.light, sky, radiance)
        over_rows(compiled_fit.reflected, len(radiance), BLOCK, *arrays)
        radiance += self.constant
        for light in range(self.lights):
            rows = slice(None) if self.lights == 1 else self.light == light
            irradiance = self.received @ self._coarse(sky[light]) + self.near[light]
            radiance[rows] += self.diffuse[rows] * irradiance[self.element.numpy()[rows]]
        return radiance

    def gradient(self, residual: np.ndarray) -> np.ndarray:
        """Return the gradient [lights, cells, 3] of the sum of predictions times `residual`."""
        residual = np.ascontiguousarray(residual, np.float32)
        parts = math.ceil(len(residual) / ROWS)
        sums = np.zeros((parts, self.lights, self.fine**2, 3), np.float32)
        arrays = (ROWS, self.cells, self.weights, self.f0, self.light, residual, sums)
        over_rows(compiled_fit.gathered, parts, 1, *arrays)
        gradient = sums.sum(axis=0)
        for light in range(self.lights):
            of_light = residual if self.lights == 1 else residual * (self.light == light)[:, None]
            per_element = np.add.reduceat(self.diffuse * of_light, self.elements.first[:-1].numpy(), axis=0)
            gradient[light] += self._spread(self.received.T @ per_element)
        return gradient

    def _coarse(self, sky: np.ndarray) -> np.ndarray:
        shape = (self.side, self.scale, self.side, self.scale, 3)
        return sky.reshape(shape).mean(axis=(1, 3)).reshape(-1, 3)

    def _spread(self, coarse: np.ndarray) -> np.ndarray:
        square = coarse.reshape(self.side, 1, self.side, 1, 3) / self.scale**2
        shape = (self.side, self.scale, self.side, self.scale, 3)
        return np.broadcast_to(square, shape).reshape(-1, 3)


def fit_light(
    prediction: Prediction,
    sky: Float[Tensor, "lights cells 3"],
    *,
    steps: int,
    rate: float,
    outlier: float,
    tether: float,
) -> tuple[Float[Tensor, "lights cells 3"], float, float]:
    """Return the environments after Adam's steps in log radiance, and the loss before and after."""
    elements = prediction.elements
    wanted, clipped = elements.colour.numpy(), elements.clipped.numpy()
    weight = 1.0 / (wanted + NOISE_FLOOR)
    begun = np.log(sky.numpy().clip(1e-3))
    value = begun.copy()
    first, second = np.zeros_like(value), np.zeros_like(value)
    losses = []
    for step in range(steps + 1):
        now = np.exp(value)
        error = prediction(now) - wanted
        error[clipped & (error > 0.0)] = 0.0
        squared = (error * error * weight).sum(axis=1)
        root = np.sqrt(squared + outlier**2)
        losses.append(float(root.mean()))
        if step == steps:
            break
        residual = error * weight / root[:, None] / len(error)
        gradient = prediction.gradient(residual.astype(np.float32)) * now
        gradient = gradient + tether * (value - begun) / value[..., 0].size
        first = 0.9 * first + 0.1 * gradient
        second = 0.98 * second + 0.02 * gradient**2
        moved = (first / (1 - 0.9 ** (step + 1))) / (np.sqrt(second / (1 - 0.98 ** (step + 1))) + 1e-12)
        value = value - rate * (1.0 - step / steps) ** 0.5 * moved
    return torch.from_numpy(np.exp(value).astype(np.float32)), losses[0], losses[-1]
