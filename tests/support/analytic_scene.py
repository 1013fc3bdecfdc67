"""Scenes of spheres, boxes and planes, hit exactly: as numpy functions and as ONNX expressions.

Every function takes `ops` (NumpyOps or OnnxOps) and works on arrays or graph values of shape [n, 3].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from support.onnx_expressions import NumpyOps

FAR = 100.0


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Constant material of a shape."""

    albedo: tuple[float, float, float] = (0.8, 0.8, 0.8)
    perceptual_roughness: float = 1.0
    metalness: float = 0.0


@dataclass(frozen=True)
class Sphere:
    centre: tuple[float, float, float]
    radius: float
    surface: Surface = Surface()

    def hit(self, ops, origin, direction, near):
        """Return (distance, hits) of the first intersection beyond `near`, from outside or inside."""
        to_origin = origin - ops.constant(self.centre)
        b = ops.sum(to_origin * direction)
        discriminant = b * b - (ops.sum(to_origin * to_origin) - self.radius**2)
        root = ops.sqrt(ops.maximum(discriminant, ops.constant(0.0)))
        entry, leave = -b - root, -b + root
        distance = ops.where(entry > near, entry, leave)
        return distance, ops.both(discriminant > 0.0, distance > near)

    def normal(self, ops, position):
        offset = position - ops.constant(self.centre)
        return offset / ops.sqrt(ops.sum(offset * offset))

    def gap(self, ops, position):
        """Return how far `position` is from the surface."""
        offset = position - ops.constant(self.centre)
        return ops.abs(ops.sqrt(ops.sum(offset * offset)) - self.radius)


@dataclass(frozen=True)
class Plane:
    point: tuple[float, float, float]
    direction: tuple[float, float, float]
    surface: Surface = Surface()

    def hit(self, ops, origin, direction, near):
        along = ops.sum(direction * ops.constant(self.direction))
        safe = ops.where(ops.abs(along) < 1e-9, ops.constant(1e-9), along)
        distance = ops.sum((ops.constant(self.point) - origin) * ops.constant(self.direction)) / safe
        return distance, ops.both(distance > near, distance < FAR)

    def normal(self, ops, position):
        return position * 0.0 + ops.constant(self.direction)

    def gap(self, ops, position):
        return ops.abs(ops.sum((position - ops.constant(self.point)) * ops.constant(self.direction)))


@dataclass(frozen=True)
class Box:
    minimum: tuple[float, float, float]
    maximum: tuple[float, float, float]
    surface: Surface = Surface()

    def hit(self, ops, origin, direction, near):
        inverse = 1.0 / ops.where(ops.abs(direction) < 1e-9, ops.constant(1e-9), direction)
        first = (ops.constant(self.minimum) - origin) * inverse
        second = (ops.constant(self.maximum) - origin) * inverse
        entry = ops.largest(ops.minimum(first, second))
        leave = ops.smallest(ops.maximum(first, second))
        distance = ops.where(entry > near, entry, leave)
        return distance, ops.both(leave >= entry, distance > near)

    def _local(self, ops, position):
        low, high = np.array(self.minimum), np.array(self.maximum)
        return (position - ops.constant((low + high) / 2)) / ops.constant((high - low) / 2)

    def normal(self, ops, position):
        local = self._local(ops, position)
        size = ops.abs(local)
        return ops.sign(local) * ops.where(size >= ops.largest(size), ops.constant(1.0), ops.constant(0.0))

    def gap(self, ops, position):
        return ops.abs(ops.largest(ops.abs(self._local(ops, position))) - 1.0)


@dataclass(frozen=True)
class AnalyticScene:
    """Shapes, and the rule for rays that leave them."""

    shapes: tuple[Sphere | Plane | Box, ...]
    origin_offset: float = 1e-3
    near: float = 1e-4

    def first_hit(self, ops, origin, direction, near):
        """Return (distance, hits) of the nearest shape; distance is FAR where nothing is hit."""
        nearest = None
        for shape in self.shapes:
            distance, hits = shape.hit(ops, origin, direction, near)
            distance = ops.where(hits, distance, ops.constant(FAR))
            nearest = distance if nearest is None else ops.minimum(nearest, distance)
        return nearest, nearest < FAR

    def surface_at(self, ops, position):
        """Return (albedo, perceptual_roughness, metalness, normal) of the shape nearest to `position`."""
        found, nearest = None, None
        for shape in self.shapes:
            zero = ops.sum(position * 0.0)
            values = (
                zero + ops.constant(shape.surface.albedo),
                zero + shape.surface.perceptual_roughness,
                zero + shape.surface.metalness,
                shape.normal(ops, position),
            )
            gap = shape.gap(ops, position)
            if found is None:
                found, nearest = values, gap
                continue
            closer = gap < nearest
            found = tuple(ops.where(closer, a, b) for a, b in zip(values, found, strict=True))
            nearest = ops.minimum(gap, nearest)
        return found


def trace(scene: AnalyticScene, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (distance [n, 1], hits [n, 1]) of secondary rays, in float64."""
    return scene.first_hit(NumpyOps, origin, direction, scene.near)
