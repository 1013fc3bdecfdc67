"""Texels blended at the fragments of pixels."""

import itertools

import numpy as np
from lambent_relight.baked.raster import nearest_texel
from lambent_relight.baked.texel_blend import blended_texels, weighted_sums
from support.texture_lookup import sample_plane

SIZE = 8
RNG = np.random.default_rng(5)


def full_plane():
    return np.arange(SIZE * SIZE, dtype=np.int32).reshape(SIZE, SIZE)


def at(plane, uv, values, first=None):
    first = np.arange(len(uv) + 1, dtype=np.int64) if first is None else first
    return weighted_sums(values, *blended_texels(plane, uv, first))


def test_between_texels_values_are_bilinear():
    values = RNG.random((SIZE * SIZE, 3)).astype(np.float32)
    uv = RNG.random((200, 2), np.float32)
    found = at(full_plane(), uv, values)
    np.testing.assert_allclose(found, sample_plane(values.reshape(SIZE, SIZE, 3), uv), atol=2e-6)


def test_a_pixel_is_the_mean_of_its_fragments_and_names_each_texel_once():
    values = RNG.random((SIZE * SIZE, 2)).astype(np.float32)
    uv = RNG.random((12, 2), np.float32) * 0.2 + 0.4
    first = np.array([0, 4, 5, 5, 12], np.int64)
    texel, share, begin = blended_texels(full_plane(), uv, first)
    found = weighted_sums(values, texel, share, begin)
    each = sample_plane(values.reshape(SIZE, SIZE, 2), uv)
    for pixel, (start, end) in enumerate(itertools.pairwise(first)):
        own = texel[begin[pixel] : begin[pixel + 1]]
        assert len(set(own.tolist())) == len(own)
        if start == end:
            assert len(own) == 0
            continue
        assert np.isclose(share[begin[pixel] : begin[pixel + 1]].sum(), 1.0, atol=1e-6)
        np.testing.assert_allclose(found[pixel], each[start:end].mean(axis=0), atol=2e-6)


def test_beyond_the_border_of_a_chart_its_own_texels_go_on():
    # Two charts, two texels apart: columns 0 to 2 and 5 to 7.
    covered = np.ones((SIZE, SIZE), bool)
    covered[:, 3:5] = False
    index = np.flatnonzero(covered.ravel()).astype(np.int32)
    plane = nearest_texel(index, SIZE)
    values = np.where(index % SIZE < 3, 1.0, 5.0).astype(np.float32)[:, None]
    left = np.stack([np.linspace(0.0, 3.0 / SIZE, 40), RNG.random(40)], axis=-1).astype(np.float32)
    np.testing.assert_allclose(at(plane, left, values), 1.0, atol=1e-6)
    right = left + np.float32([5.0 / SIZE, 0.0])
    np.testing.assert_allclose(at(plane, right, values), 5.0, atol=1e-6)
