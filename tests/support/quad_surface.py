"""Rectangles with an atlas: a surface whose light transport is known or can be traced exactly.

Each rectangle fills one square chart of `side` x `side` texels; charts stand side by side, two texels apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from lambent_asset.transport.transport_bounce import Reflectors
from lambent_asset.transport.transport_rays import BakedSurface


@dataclass(frozen=True)
class Quad:
    """The points corner + a u + b v for a, b in [0, 1]; it faces u x v."""

    corner: tuple[float, float, float]
    u: tuple[float, float, float]
    v: tuple[float, float, float]
    albedo: tuple[float, float, float] = (0.5, 0.5, 0.5)
    perceptual_roughness: float = 0.8
    metalness: float = 0.0

    @property
    def normal(self) -> np.ndarray:
        n = np.cross(self.u, self.v)
        return n / np.linalg.norm(n)


def box_of_quads(half: float = 1.0, *, inwards: bool = True, **surface: object) -> list[Quad]:
    """Return the six walls of a cube about the origin."""
    quads = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            corner, u, v = np.full(3, -half), np.zeros(3), np.zeros(3)
            corner[axis] = sign * half
            u[(axis + 1) % 3], v[(axis + 2) % 3] = 2 * half, 2 * half
            if (sign > 0) == inwards:
                u, v = v, u
            quads.append(Quad(tuple(corner), tuple(u), tuple(v), **surface))
    return quads


def surface_of(quads: list[Quad], side: int) -> tuple[BakedSurface, Reflectors, dict[str, np.ndarray]]:
    """Return texels, their materials, and the mesh (vertices, faces, uv) of `quads`."""
    across = int(np.ceil(np.sqrt(len(quads))))
    size = across * (side + 2)
    parts, mesh = [], {"vertices": [], "faces": [], "uv": []}
    for number, quad in enumerate(quads):
        row0, column0 = (1 + (number // across) * (side + 2)), (1 + (number % across) * (side + 2))
        row, column = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
        a, b = (column.ravel() + 0.5) / side, (row.ravel() + 0.5) / side
        position = np.array(quad.corner) + a[:, None] * np.array(quad.u) + b[:, None] * np.array(quad.v)
        index = (row.ravel() + row0) * size + column.ravel() + column0
        values = [*quad.albedo, quad.perceptual_roughness, quad.metalness]
        parts.append(
            np.concatenate(
                [index[:, None], position, np.tile(quad.normal, (side**2, 1)), np.tile(values, (side**2, 1))],
                axis=1,
            )
        )
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
        mesh["vertices"].append(np.array(quad.corner) + corners @ np.array([quad.u, quad.v]))
        mesh["uv"].append((corners * side + [column0, row0]) / size)
        mesh["faces"].append(np.array([[0, 1, 2], [0, 2, 3]]) + 4 * number)
    table = np.concatenate(parts)
    table = table[np.argsort(table[:, 0])]
    surface = BakedSurface(
        size,
        table[:, 0].astype(np.int32),
        table[:, 1:4].astype(np.float32),
        table[:, 4:7].astype(np.float32),
    )
    reflectors = Reflectors(
        table[:, 7:10].astype(np.float32),
        table[:, 10:11].astype(np.float32),
        table[:, 11:12].astype(np.float32),
    )
    arrays = {name: np.concatenate(values) for name, values in mesh.items()}
    return (
        surface,
        reflectors,
        {
            "vertices": arrays["vertices"].astype(np.float32),
            "faces": arrays["faces"].astype(np.int32),
            "uv": arrays["uv"].astype(np.float32),
        },
    )


def trace_quads(quads: list[Quad], far: float = 100.0):
    """Return the exact answer of a fast cache for these rectangles, seen from both sides."""

    def secondary(origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nearest = np.full(len(origin), far)
        for quad in quads:
            u, v, n = np.array(quad.u), np.array(quad.v), quad.normal
            along = direction @ n
            with np.errstate(divide="ignore", invalid="ignore"):
                t = ((np.array(quad.corner) - origin) @ n) / along
                place = origin + t[:, None] * direction - np.array(quad.corner)
                a, b = place @ u / (u @ u), place @ v / (v @ v)
                hit = (t > 1e-4) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)
            nearest = np.where(hit & (t < nearest), t, nearest)
        opacity = (nearest < far).astype(np.float32)[:, None]
        return opacity, nearest.astype(np.float32)[:, None]

    return secondary
