"""Surfaces hit by camera rays, without a graph runtime: the same rule as the gbuffer graph, without hidden
parts.

A ray is sampled at fixed fractions of its stretch inside the object's box. Its samples are taken front to
back until less than 1e-7 of the light gets through; the density is not evaluated where the occupancy leaves
nothing of it, normal and material not for groups of samples whose share of the ray is below 1e-6.
Source: paper Eq. 3; docs/reference/bundle-format.md.
"""

import math

import numpy as np
from lambent_compute.compiling import compiled, inlined

from lambent_relight.bundle.bundle import Bundle
from lambent_relight.bundle.graphs import PrimaryHits, Rows
from lambent_relight.fused import fields
from lambent_relight.fused.weights import NotFused, Weights

_OPACITY_FLOOR = np.float32(1e-3)
_UPRIGHT_OPACITY = np.float32(0.01)
_DARK = 1e-7
_NEGLIGIBLE = np.float32(1e-6)
_SAMPLES_AT_ONCE = 16


class FusedGbuffer:
    """Surfaces along camera rays."""

    def __init__(self, bundle: Bundle, weights: Weights) -> None:
        """Collect the networks; raises NotFused when the bundle has others."""
        extra = ("box_min", "box_max", "num_samples", "group")
        self._fields, constants = fields.Fields.of(bundle, weights, "gbuffer", extra)
        low, high = (np.asarray(constants[name], np.float32) for name in extra[:2])
        count, group = int(constants["num_samples"]), int(constants["group"])
        whole = group >= 1 and count >= 1 and count % group == 0
        if not whole or count > 4096 or low.shape != (3,) or high.shape != (3,):
            raise NotFused("the gbuffer's sampling rule is not understood")
        self._low, self._high, self._count, self._group = low, high, count, group

    def __call__(self, origin: Rows, direction: Rows, out: PrimaryHits) -> None:
        """Write the surfaces hit by rays [row, 3]."""
        entry, start, length = self._stretches(origin, direction)
        work = self._fields.work()
        weight = self._weights(entry, direction, length, work)
        rays, positions, masses, opacity, distance = _groups(
            entry, direction, length[:, 0], weight, self._group
        )
        properties = np.empty((len(rays), fields.NUM_PROPERTIES), np.float32)
        fields.surfaces(self._fields, positions, work, properties)
        total = _sums(rays, masses, properties, len(origin))
        share = np.float32(1.0) / np.maximum(opacity, _OPACITY_FLOOR)
        out.opacity[:] = opacity
        out.distance[:] = (distance + start * opacity) * share
        normal = total[:, :3]
        normal[:, 2:] += np.maximum(_UPRIGHT_OPACITY - opacity, 0.0)
        out.normal[:] = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-8)
        out.albedo[:] = total[:, 3:6] * share
        out.perceptual_roughness[:] = total[:, 6:7] * share
        out.metalness[:] = total[:, 7:8] * share

    def _stretches(self, origin: Rows, direction: Rows) -> tuple[Rows, Rows, Rows]:
        """Return where rays enter the box [ray, 3], at which distance, and the length inside [ray, 1]."""
        safe = np.where(np.abs(direction) < 1e-9, np.float32(1e-9), direction)
        first, second = (self._low - origin) / safe, (self._high - origin) / safe
        start = np.maximum(np.minimum(first, second).max(axis=-1, keepdims=True), np.float32(0.0))
        end = np.maximum(np.maximum(first, second).min(axis=-1, keepdims=True), start)
        return origin + start * direction, start, end - start

    def _weights(self, entry: Rows, direction: Rows, length: Rows, work: Rows) -> Rows:
        """Return the render weights of all samples, [ray, sample]."""
        weight = np.zeros((len(entry), self._count), np.float32)
        depth_before = np.zeros(len(entry))
        active = np.flatnonzero(length[:, 0] > 0.0)
        for first in range(0, self._count, _SAMPLES_AT_ONCE):
            last = min(first + _SAMPLES_AT_ONCE, self._count)
            positions = _positions(entry, direction, length[:, 0], active, first, last, self._count)
            density = np.empty(len(positions), np.float32)
            fields.densities(self._fields, positions, work, density)
            active = _march(density, length[:, 0], active, first, last, depth_before, weight)
        return weight


@inlined()
def _inside(length, k, count):
    """Return the distance of sample `k` of `count` from the box."""
    return length * np.float32((k + 0.5) / count)


@compiled()
def _positions(entry, direction, length, active, first, last, count):
    """Return the places of samples `first` to `last` of the rays `active`, [ray * sample, 3]."""
    positions = np.empty((len(active) * (last - first), 3), np.float32)
    row = np.int64(0)
    for ray in active:
        for k in range(first, last):
            step = _inside(length[ray], k, count)
            for axis in range(3):
                positions[row, axis] = entry[ray, axis] + step * direction[ray, axis]
            row += 1
    return positions


@compiled()
def _march(density, length, active, first, last, depth_before, weight):
    """Write the weights of samples `first` to `last`; return the rays through which light still gets."""
    count, num_left, row = weight.shape[1], np.int64(0), np.int64(0)
    left = np.empty(len(active), np.int64)
    for ray in active:
        step, before = length[ray] / np.float32(count), depth_before[ray]
        for k in range(first, last):
            depth = np.float64(density[row]) * np.float64(step)
            if depth > 0.0:
                weight[ray, k] = -math.expm1(-depth) * math.exp(-before)
                before += depth
            row += 1
        depth_before[ray] = before
        if math.exp(-before) > _DARK:
            left[num_left] = ray
            num_left += 1
    return left[:num_left]


@compiled()
def _groups(entry, direction, length, weight, group):
    """Return the groups of samples that count, and per ray the opacity and the mean distance from the box.

    Of each group: its ray, the place of its mean sample [group, 3], and its share of the ray.
    """
    num_rays, count = weight.shape
    most = num_rays * (count // group)
    rays, masses = np.empty(most, np.int64), np.empty(most, np.float32)
    positions = np.empty((most, 3), np.float32)
    opacity, distance = np.empty((num_rays, 1), np.float32), np.empty((num_rays, 1), np.float32)
    num_groups = np.int64(0)
    for ray in range(num_rays):
        total, moments = 0.0, 0.0
        for k in range(count):
            total += weight[ray, k]
            moments += weight[ray, k] * _inside(length[ray], k, count)
        opacity[ray, 0], distance[ray, 0] = total, moments
        least = _NEGLIGIBLE * max(opacity[ray, 0], _OPACITY_FLOOR)
        for first in range(0, count, group):
            mass, moment = np.float32(0.0), np.float32(0.0)
            for k in range(first, first + group):
                mass += weight[ray, k]
                moment += weight[ray, k] * _inside(length[ray], k, count)
            if mass > least:
                middle = moment / max(mass, np.float32(1e-6))
                for axis in range(3):
                    positions[num_groups, axis] = entry[ray, axis] + middle * direction[ray, axis]
                rays[num_groups], masses[num_groups] = ray, mass
                num_groups += 1
    return rays[:num_groups], positions[:num_groups], masses[:num_groups], opacity, distance


@compiled()
def _sums(rays, masses, values, num_rays):
    """Return the sums of `found` [group, n] times `masses` over the groups of each ray, [ray, n]."""
    total = np.zeros((num_rays, values.shape[1]))
    for g in range(len(rays)):
        for i in range(values.shape[1]):
            total[rays[g], i] += values[g, i] * masses[g]
    return total.astype(np.float32)
