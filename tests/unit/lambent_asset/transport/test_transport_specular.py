"""The compiled pass over hits is the formula of the relighter, written with its functions."""

import numpy as np
import pytest
from lambent_asset.transport import transport_specular
from lambent_asset.transport.transport_specular import RayHits, mirrored_light
from lambent_relight.baked.split_sum import split_sum
from lambent_relight.baked.transport_kernels import basis_rows
from lambent_relight.baked.transport_lobes import factors_at, ggx_bands, per_coefficient


def units(rng, count):
    vectors = rng.normal(size=(count, 3))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("visibility_bands", [2, 3, 4])
def test_mirrored_light_and_the_rest_are_the_relighters_terms(visibility_bands, monkeypatch):
    monkeypatch.setattr(transport_specular, "_RECEIVERS_AT_ONCE", 3)
    rng = np.random.default_rng(visibility_bands)
    num_texels, counts = 50, np.array([0, 7, 40, 0, 11, 3, 60, 0])
    first = np.concatenate([[0], np.cumsum(counts)])
    receiver = np.repeat(np.arange(len(counts)), counts)
    texel = rng.integers(0, num_texels, len(receiver))
    weight, direction = rng.random(len(receiver)).astype(np.float32), units(rng, len(receiver))
    normals, roughness = units(rng, num_texels), rng.uniform(0.0, 1.0, num_texels).astype(np.float32)
    f0 = rng.random((num_texels, 3)).astype(np.float32)
    visibility = rng.normal(0.5, 1.0, (num_texels, visibility_bands**2)).astype(np.float32)
    mirrored, rest = mirrored_light(
        RayHits(first, texel, weight, direction), normals, roughness, f0, visibility, 9
    )

    cosine = -np.einsum("ni,ni->n", direction, normals[texel])
    mirror = direction + 2.0 * cosine[:, None] * normals[texel]
    scale, bias = split_sum(np.clip(cosine, 0.0, 1.0), roughness[texel])
    reflectance = (f0[texel] * scale[:, None] + bias[:, None]) * (cosine > 0.0)[:, None]
    bands = max(3, visibility_bands)
    lobe = per_coefficient(factors_at(ggx_bands(bands), roughness[texel]))
    basis = basis_rows(mirror, bands) * lobe
    free = np.einsum("nk,nk->n", basis[:, : visibility_bands**2], visibility[texel]).clip(0.0, 1.0)
    part = weight[:, None] * reflectance
    expected = np.zeros((len(counts), 9, 3))
    np.add.at(expected, receiver, (part * free[:, None])[:, None] * basis[:, :9, None])
    assert ((free > 0.0) & (free < 1.0)).mean() > 0.05
    np.testing.assert_allclose(rest, part * (1.0 - free)[:, None], atol=2e-6)
    np.testing.assert_allclose(mirrored, expected, atol=1e-5)
