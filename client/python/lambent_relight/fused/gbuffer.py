"""Surfaces hit by camera rays, without a graph runtime: the same rule as the gbuffer graph, without hidden
parts.

A ray is sampled at fixed fractions of its stretch inside the object's box. Its samples are taken front to
back until less than 1e-7 of the light gets through; normal and material are not evaluated for groups of
samples whose share of the ray is below 1e-6. Source: paper Eq. 3; docs/reference/bundle-format.md.
"""

import numpy as np
from numpy.typing import NDArray

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import PrimaryHits, Rows
from lambent_relight.fused import kernels
from lambent_relight.fused.fields import SurfaceFields
from lambent_relight.fused.weights import NotFused, Weights

_OPACITY_FLOOR = np.float32(1e-3)
_UPRIGHT_OPACITY = np.float32(0.01)
_DARK = 1e-7
_NEGLIGIBLE = 1e-6
_SAMPLES_AT_ONCE = 16


class FusedGbuffer:
    """Surfaces along camera rays."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the networks; raises NotFused when the bundle has others."""
        extra = ("box_min", "box_max", "num_samples", "group")
        self._fields = SurfaceFields(bundle, weights, "gbuffer", extra)
        constants = self._fields.constants
        self._low = np.asarray(constants["box_min"], np.float32)
        self._high = np.asarray(constants["box_max"], np.float32)
        self._count, self._group = int(constants["num_samples"]), int(constants["group"])
        whole = self._group >= 1 and self._count >= 1 and self._count % self._group == 0
        if not whole or self._count > 4096 or self._low.shape != (3,) or self._high.shape != (3,):
            raise NotFused("the gbuffer's sampling rule is not understood")

    def __call__(self, origin: Rows, direction: Rows, out: PrimaryHits) -> None:
        """Write the surfaces hit by rays [row, 3]."""
        start, end = self._stretch(origin, direction)
        entry = origin + start * direction
        length = end - start
        weight, inside = self._weights(entry, direction, length)
        opacity = weight.sum(axis=1, keepdims=True)
        share = np.float32(1.0) / np.maximum(opacity, _OPACITY_FLOOR)
        out.opacity[:] = opacity
        out.distance[:] = (weight * (start + inside)).sum(axis=1, keepdims=True) * share

        grouped = (len(origin), self._count // self._group, self._group)
        mass = weight.reshape(grouped).sum(axis=-1)
        moment = (weight * inside).reshape(grouped).sum(axis=-1)
        row, group = np.nonzero(mass > _NEGLIGIBLE * np.maximum(opacity, _OPACITY_FLOOR))
        middle = moment[row, group] / np.maximum(mass[row, group], np.float32(1e-6))
        found = self._surface(entry[row] + middle[:, None] * direction[row]) * mass[row, group]
        total = np.stack([np.bincount(row, values, len(origin)) for values in found], axis=-1)
        total = total.astype(np.float32)
        normal = total[:, :3]
        normal[:, 2:] += np.maximum(_UPRIGHT_OPACITY - opacity, 0.0)
        out.normal[:] = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-8)
        out.albedo[:] = total[:, 3:6] * share
        out.perceptual_roughness[:] = total[:, 6:7] * share
        out.metalness[:] = total[:, 7:8] * share

    def _stretch(self, origin: Rows, direction: Rows) -> tuple[Rows, Rows]:
        safe = np.where(np.abs(direction) < 1e-9, np.float32(1e-9), direction)
        first, second = (self._low - origin) / safe, (self._high - origin) / safe
        start = np.maximum(np.minimum(first, second).max(axis=-1, keepdims=True), np.float32(0.0))
        return start, np.maximum(np.maximum(first, second).min(axis=-1, keepdims=True), start)

    def _weights(self, entry: Rows, direction: Rows, length: Rows) -> tuple[Rows, Rows]:
        """Return render weights and distances from the box of every sample, [ray, sample] each."""
        fractions = ((np.arange(self._count) + 0.5) / self._count).astype(np.float32)
        inside = length * fractions
        weight = np.zeros_like(inside)
        depth_before = np.zeros(len(entry))
        active = np.flatnonzero(length[:, 0] > 0.0)
        for first in range(0, self._count, _SAMPLES_AT_ONCE):
            part = slice(first, min(first + _SAMPLES_AT_ONCE, self._count))
            steps = inside[active, part]
            points = entry[active, None] + steps[..., None] * direction[active, None]
            density = self._density(points.reshape(-1, 3)).reshape(steps.shape)
            depth = density.astype(np.float64) * (length[active] / self._count)
            ends = depth_before[active, None] + np.cumsum(depth, axis=1)
            weight[active, part] = -np.expm1(-depth) * np.exp(depth - ends)
            depth_before[active] = ends[:, -1]
            active = active[np.exp(-ends[:, -1]) > _DARK]
        return weight, inside

    def _density(self, positions: Rows) -> NDArray[np.float32]:
        density = np.empty(len(positions), np.float32)
        for part, points, count in kernels.blocks(positions):
            share = self._fields.occupied(points, count)
            found = self._fields.density(self._fields.contract(points, count), count)[1]
            density[part] = found[:count] if share is None else (found * share)[:count]
        return density

    def _surface(self, positions: Rows) -> NDArray[np.float32]:
        """Return normal (3), albedo (3), perceptual roughness and metalness as [8, point]."""
        found = np.empty((8, len(positions)), np.float32)
        for part, points, count in kernels.blocks(positions):
            self._fields.contract(points, count)
            hidden, _ = self._fields.density(points, count)
            found[:3, part] = self._fields.normal(points, count, hidden)[:, :count]
            found[3:, part] = self._fields.materials(points, count)[:, :count]
        return found
