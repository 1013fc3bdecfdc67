"""Qualities `preview` and `baked`: relighting from baked transport, one matrix product per light.

    diffuse  = (1 - m) albedo / pi (E_direct + E_indirect)
    specular = (F0 scale + bias) (s prefiltered(mirror) + (1 - s) surroundings) + glints

E is the texels' irradiance; s in [0, 1] is the unoccluded share of the lobe, from the visibility's harmonics
smoothed by the lobe; the rest sees the mean radiance of the surroundings. Dominant lights are removed
from the prefiltered map and reflected one by one, each with its own shadow (`baked.dominant_highlights`).
`preview` keeps three bands, has no indirect light, and takes s from the openness alone. Source:
docs/reference/conventions.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from lambent_core.directions import dot
from numpy.typing import NDArray

from lambent_relight.baked import kernels as baked_kernels
from lambent_relight.baked.dominant_highlights import glints, lobe_scale
from lambent_relight.baked.light import (
    PREVIEW_BANDS,
    BakedLight,
    LitTexels,
    sky_irradiance,
    texel_bounce,
)
from lambent_relight.baked.shadow_maps import ShadowMap, pattern_turns
from lambent_relight.baked.split_sum import split_sum
from lambent_relight.baked.transport_lobes import open_share
from lambent_relight.baked.view import BakedView
from lambent_relight.brdf import base_reflectance, materials_from_roughness
from lambent_relight.edits import MaterialEdit


@dataclass(frozen=True, eq=False)
class Lobes:
    """The light-independent reflection factors of a view's pixels; [pixel, n] each."""

    albedo: NDArray[np.float32]
    perceptual_roughness: NDArray[np.float32]
    diffuse: NDArray[np.float32]
    """Diffuse albedo over pi, [pixel, 3]."""
    free: NDArray[np.float32]
    """Specular reflectance times the free part of the lobe, [pixel, 3]."""
    surrounded: NDArray[np.float32]
    """Specular reflectance times the rest, times the factor to mean radiance, [pixel, 3]."""
    mirror: NDArray[np.float32]
    """Direction of mirror reflection, [pixel, 3]."""
    alpha: NDArray[np.float32]
    """GGX width, [pixel]."""
    lobe_scale: NDArray[np.float32]
    """One over the integral of the prefilter's weight, 1/sr, [pixel]."""
    f0: NDArray[np.float32]
    """Specular reflectance at normal incidence, [pixel, 3]."""


def lobes_of(view: BakedView, edit: MaterialEdit, *, preview: bool) -> Lobes:
    """Return the reflection factors of a view's pixels, with `edit` applied."""
    albedo, roughness = edit.apply(view.albedo, view.perceptual_roughness)
    cosine = dot(view.normal, view.omega_o)
    mirror = (2.0 * cosine * view.normal - view.omega_o).astype(np.float32)
    scale, bias = split_sum(cosine[:, 0], roughness[:, 0])
    alpha = materials_from_roughness(albedo, roughness, view.metalness).alpha[:, 0].astype(np.float32)
    f0 = base_reflectance(albedo, view.metalness)
    reflectance = f0 * scale[:, None] + bias[:, None]
    free = view.openness if preview else open_share(mirror, roughness[:, 0], view.visibility)
    return Lobes(
        albedo,
        roughness,
        ((1.0 - view.metalness) * albedo / np.float32(np.pi)).astype(np.float32),
        (reflectance * free).astype(np.float32),
        (reflectance * (1.0 - free) * view.surroundings).astype(np.float32),
        mirror,
        alpha,
        lobe_scale(alpha),
        f0.astype(np.float32),
    )


def shade(
    view: BakedView,
    lit: LitTexels,
    lobes: Lobes,
    light: BakedLight,
    shadows: Sequence[ShadowMap],
    *,
    preview: bool,
    indirect: bool,
    bounce_gain: NDArray[np.float32],
) -> dict[str, NDArray[np.float32]]:
    """Return the radiance of the pixels of `view` under `light`; `lit` are its used texels.

    `shadows` are those of its dominant lights.

    Pictures [height, width, 3] by the name of their pass, black outside the object: rgb, direct, indirect,
    diffuse and specular. `bounce_gain` [3] is the effect of an edit of all albedos on bounced light.
    """
    bands = PREVIEW_BANDS if preview else round(len(lit.direct) ** 0.5)
    straight = sky_irradiance(lit, light, bands)
    bounced = texel_bounce(lit, light) * bounce_gain
    if preview or not indirect:
        bounced = np.zeros_like(bounced)
    prefiltered = light.prefiltered.lookup(lobes.mirror, lobes.perceptual_roughness[:, 0])
    glint, lamps = np.zeros_like(prefiltered), np.zeros_like(prefiltered)
    if len(light.directions):
        shares, cosines = _lit_shares(view, shadows)
        lamps = cosines @ light.irradiance
        prefiltered, glint = glints(
            (view.normal, view.omega_o, lobes.mirror),
            (lobes.alpha, lobes.lobe_scale, lobes.f0),
            (light.directions, light.irradiance, shares.T),
            prefiltered,
        )
    parts = baked_kernels.shade_pixels(
        (view.pixel, view.within, view.texel, view.share, view.first),
        (straight, bounced, lamps, prefiltered, glint),
        (lobes.diffuse, lobes.free, lobes.surrounded),
        view.camera.height * view.camera.width,
    )
    shape = (view.camera.height, view.camera.width, 3)
    names = ("rgb", "direct", "indirect", "diffuse", "specular")
    return {name: part.reshape(shape) for name, part in zip(names, parts, strict=True)}


def _lit_shares(
    view: BakedView, shadows: Sequence[ShadowMap]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the shares of lights that reach pixels, and the same times the cosine, [pixel, light] each."""
    points = view.points
    turn = pattern_turns(points.row, points.column)
    shares = np.stack([each.shares(points.position, points.normal, turn) for each in shadows], axis=-1)
    towards = np.stack([each.axes[2] for each in shadows]).astype(np.float32)
    cosine = np.maximum(points.normal @ towards.T, np.float32(0.0))
    return view.mean_of_points(shares), view.mean_of_points(shares * cosine)
