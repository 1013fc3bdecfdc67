"""Light transport of a whole surface: shadows, openness of the sky, and light from surface to surface.

The transfer of a texel is the vector T with irradiance = T . l for a light with spherical-harmonic
coefficients l. Direct transfer is that of an open sky, which is known exactly, minus what the rays find
blocked: an unshadowed texel has no noise at all. Source: docs/method.md (relighting), Sloan et al. 2002
(Precomputed Radiance Transfer).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from lambent_compute.threads import available_threads, for_each
from lambent_core.errors import WorkerError
from lambent_proto.v1 import bundle_pb2
from lambent_relight.baked.transport import Transport, transport_files
from lambent_relight.baked.transport_kernels import basis_rows, mirrored_sums
from lambent_relight.environment import harmonics
from numpy import ndarray

from lambent_asset.transport.transport_bounce import Reflectors, indirect_transfer
from lambent_asset.transport.transport_rays import (
    CELL,
    BakedSurface,
    Occlusion,
    RayConfig,
    SecondaryRays,
    cast,
    direction_sets,
)
from lambent_asset.transport.transport_smoothing import smoothing

TIERS = {"full": (7, 4, True), "lite": (5, 3, False)}
"""Bands of direct transfer and of visibility, and whether there are shadow bits."""
INDIRECT_BANDS = 3
LEAST_OPACITY = 12
"""Of 255; smaller opacities are left out of the mirrored half of visibility."""


@dataclass(frozen=True, kw_only=True, slots=True)
class TransportConfig:
    """Settings of the transport bake."""

    tier: str = "full"
    """"full" or "lite"; everything in a lite bundle is a part of the full one."""
    num_bounces: int = 32
    """Maximum number of bounces between surfaces; fewer once another adds next to nothing."""
    rays: RayConfig = field(default_factory=RayConfig)

    def __post_init__(self) -> None:
        if self.tier not in TIERS or self.num_bounces < 1:
            raise WorkerError(
                "export.transport",
                f"tier {self.tier!r} with {self.num_bounces} bounces: expected one of {', '.join(TIERS)}, "
                "and at least one bounce; change the export's settings",
            )


def bake_transport(
    surface: BakedSurface,
    reflectors: Reflectors,
    secondary: SecondaryRays,
    *,
    origin_offset: float,
    config: TransportConfig,
    store: Path,
    advance: Callable[[float], None] = lambda share: None,
    num_threads: int = 1,
) -> tuple[Transport, dict[str, float]]:
    """Return the transport of `surface`, and metrics of the bake.

    `reflectors` are the materials of the texels; `store` keeps finished rays, so that an interrupted bake
    resumes. `advance` is called with the completed share of the rays; `num_threads` may call `secondary`.
    """
    bands, visibility_bands, with_bits = TIERS[config.tier]
    seen = cast(
        surface,
        secondary,
        origin_offset=origin_offset,
        config=config.rays,
        store=store,
        advance=advance,
        num_threads=num_threads,
    )
    directions = direction_sets(config.rays)
    smooth = smoothing(surface.positions, surface.normals)
    blocked, hidden_sky = (
        smooth @ part for part in _blocked(seen, surface.normals, directions, bands, visibility_bands)
    )
    # With nothing around it, a texel's transfer is the clamped cosine's harmonics.
    free = harmonics.basis(surface.normals, bands) * harmonics.cosine_factors(bands)
    direct = free.astype(np.float32) - blocked
    visibility = -hidden_sky
    visibility[:, 0] += np.sqrt(4.0 * np.pi)
    indirect = indirect_transfer(
        surface,
        reflectors,
        seen,
        directions,
        direct[:, : INDIRECT_BANDS**2],
        visibility,
        origin_offset=origin_offset,
        num_bounces=config.num_bounces,
    )
    coarse, _ = surface.blocks
    around = smoothing(surface.positions[coarse], surface.normals[coarse])
    indirect = np.stack([(around @ indirect[:, :, channel].T).T for channel in range(3)], axis=1)
    transport = Transport(
        surface.size,
        surface.texel_index.astype(np.int32),
        np.ascontiguousarray(direct.T, np.float32),
        np.ascontiguousarray(visibility.T, np.float32),
        np.ascontiguousarray(indirect, np.float32),
        _shadow_bits(seen) if with_bits else None,
        _material(surface, reflectors),
    )
    figures = {
        "transport_rays_per_texel": seen.num_rays / len(surface.positions),
        "transport_blocked_share": float(blocked[:, 0].mean() / (0.5 * np.sqrt(np.pi))),
    }
    return transport, figures


def write_transport(transport: Transport, manifest: bundle_pb2.BundleManifest, folder: Path) -> None:
    """Write `transport` into `folder`/transport and describe it in `manifest`."""
    (folder / "transport").mkdir(exist_ok=True)
    for path, data in transport_files(transport, manifest).items():
        (folder / path).write_bytes(data)


def _blocked(
    seen: Occlusion,
    normals: Float[ndarray, "texels 3"],
    directions: Float[ndarray, "sets directions 3"],
    bands: int,
    sky_bands: int,
) -> tuple[Float[ndarray, "texels _"], Float[ndarray, "texels _"]]:
    """Return what is missing of the transfer and of the sky.

    Of the transfer it is the sum over directions of opacity times cosine times basis, of the sky the
    harmonics of opacity, continued below the horizon as its mirror image.
    """
    transfer = np.zeros((len(normals), bands**2), np.float32)
    sky = np.zeros((len(normals), sky_bands**2), np.float32)
    share = np.float32(CELL / 255.0)

    def fill(index: int) -> None:
        """Write what is missing at the texels of one set of directions."""
        way, texels = directions[index], seen.in_set(index)
        opacity, normal = np.ascontiguousarray(seen.opacity[texels]), normals[texels]
        transfer[texels] = (opacity * np.maximum(normal @ way.T, 0.0)) @ (basis_rows(way, bands) * share)
        sky[texels] = (opacity.astype(np.float32) * share) @ basis_rows(way, sky_bands)
        sky[texels] += mirrored_sums(opacity, normal, way, sky_bands, least=LEAST_OPACITY, scale=CELL / 255.0)

    for_each(fill, range(len(directions)), available_threads())
    return transfer, sky


def _shadow_bits(seen: Occlusion) -> UInt8[ndarray, "texels _"]:
    """Return one bit per direction, set where more light passes than is held back, or below the horizon.

    A settled texel was queried in half of the directions; the others take the value of their neighbours.
    """
    return np.packbits(seen.opacity < 128, axis=1, bitorder="little")


def _material(surface: BakedSurface, reflectors: Reflectors) -> Float[ndarray, "8 texels"]:
    """Return the materials of texels as planes."""
    gloss = (reflectors.perceptual_roughness, reflectors.metalness)
    columns = (reflectors.albedo, *gloss, surface.normals)
    return np.ascontiguousarray(np.concatenate(columns, axis=1).T, np.float32)
