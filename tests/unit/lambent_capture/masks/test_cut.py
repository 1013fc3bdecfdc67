"""The graph cut follows edges where evidence is vague, and the soft edge is the true coverage."""

import cv2
import numpy as np
from lambent_capture.masks.cut import LIMIT, cut_out
from lambent_capture.masks.edge import soft_coverage


def disc(size: int, radius: float) -> np.ndarray:
    rows, columns = np.mgrid[:size, :size] + 0.5 - size / 2
    return np.clip(radius - np.hypot(rows, columns) + 0.5, 0.0, 1.0)


def coloured(coverage: np.ndarray) -> np.ndarray:
    mixed = coverage[..., None] * [190, 90, 60] + (1.0 - coverage[..., None]) * [100, 120, 140]
    noise = np.random.default_rng(0).normal(0.0, 2.0, mixed.shape)
    return np.clip(mixed + noise, 0, 255).astype(np.uint8)


def test_the_outline_snaps_to_the_edge_between_vague_evidence():
    true = disc(120, 35.0)
    odds = np.full(true.shape, -0.2)
    odds[disc(120, 25.0) > 0.5] = 4.0
    odds[disc(120, 48.0) < 0.5] = -4.0
    found = cut_out(coloured(true), odds)
    assert (found & (true > 0.5)).sum() / (found | (true > 0.5)).sum() > 0.98


def test_evidence_at_the_limit_is_obeyed_against_every_edge():
    odds = np.full((60, 60), -2.0)
    odds[20:23, 20:23] = LIMIT
    odds[30, 5:50] = -LIMIT
    odds[29, 5:50] = odds[31, 5:50] = 2.0
    found = cut_out(np.full((60, 60, 3), 120, np.uint8), odds)
    assert found[20:23, 20:23].all()
    assert not found[30, 5:50].any()


def test_evidence_of_one_kind_needs_no_cut():
    picture = np.full((20, 20, 3), 120, np.uint8)
    assert cut_out(picture, np.full((20, 20), 0.5)).all()
    assert not cut_out(picture, np.full((20, 20), -0.5)).any()


def test_soft_edges_are_the_coverage_of_pixels_at_the_larger_size():
    true = disc(300, 90.0)
    large = coloured(true)
    small = cv2.resize(large, (150, 150), interpolation=cv2.INTER_AREA)
    mask = cv2.resize(true, (150, 150), interpolation=cv2.INTER_AREA) > 0.5
    found = soft_coverage(small, mask, large)
    assert found.shape == true.shape
    overlap = ((found > 0.5) & (true > 0.5)).sum() / ((found > 0.5) | (true > 0.5)).sum()
    assert overlap > 0.985
    edge = (true > 0.05) & (true < 0.95)
    assert ((found > 0.02) & (found < 0.98))[edge].mean() > 0.6
    assert np.abs(found - true)[np.abs(true - 0.5) == 0.5].mean() < 0.01
