"""Detail comes from the sharper photograph up to a limit, and from none that differs from the others."""

import numpy as np
import pytest
from lambent_asset.textures import photo_choice
from lambent_asset.textures.photo_choice import Observations, choose
from lambent_asset.textures.photo_nodes import nodes_of
from support.atlas_box import atlas_box

BOX = atlas_box(64)
NODES = nodes_of(BOX.size, BOX.texel_index, BOX.positions, BOX.texel_normals)
COUNT = len(NODES.texel)
MODEL = np.full((COUNT, 3), 0.5, np.float32)


def saying(albedo=0.5, resolution=1.0, trust=1.0, detail=0.2):
    """Return what a photograph says that shows all nodes alike."""
    return Observations(
        np.arange(COUNT, dtype=np.int32),
        np.full((COUNT, 3), albedo, np.float32),
        *(np.full(COUNT, value, np.float32) for value in (resolution, trust, detail)),
    )


def shares(*seen):
    return [float(choice.weight.mean()) for choice in choose(NODES, list(seen), MODEL)]


def test_the_photograph_with_more_pixels_for_a_texel_is_chosen():
    assert shares(saying(resolution=0.5), saying(resolution=1.2)) == pytest.approx([0.0, 1.0], abs=1e-3)


def test_pixels_beyond_what_a_texel_can_show_do_not_make_up_for_trust():
    """A close-up whose radiance is hardly albedo's does not win by its size."""
    found = shares(saying(resolution=1.5, trust=0.9), saying(resolution=30.0, trust=0.3))
    assert found == pytest.approx([1.0, 0.0], abs=1e-3)
    assert shares(saying(trust=0.3), saying(trust=0.9)) == pytest.approx([0.0, 1.0], abs=1e-3)


def test_a_photograph_that_is_apart_everywhere_counts_less_than_each_of_its_nodes_says():
    """A little apart at one place may be a highlight; everywhere, the photograph is badly posed."""
    apart = 0.5 * np.exp(0.12)
    seen = [saying(), saying(), saying(albedo=apart)]
    scores = np.ones((COUNT, 3), np.float32)
    agreement = photo_choice._agreement(NODES, seen, scores)
    here_alone = np.exp(-((0.12 / photo_choice._AGREEMENT) ** 2))
    assert here_alone > 0.7
    np.testing.assert_allclose(agreement[:, :2], 1.0, atol=1e-3)
    assert agreement[:, 2].max() < 0.1 * here_alone


def test_a_blurred_photograph_is_not_chosen_over_a_sharp_one():
    assert shares(saying(detail=0.05), saying(detail=0.3)) == pytest.approx([0.0, 1.0], abs=1e-3)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_level_brings_a_photograph_of_another_exposure_to_the_model(factor):
    (choice,) = choose(NODES, [saying(albedo=0.5 * factor)], MODEL)
    np.testing.assert_allclose(choice.level, 1.0 / factor, rtol=1e-3)
    (choice,) = choose(NODES, [saying(albedo=0.01)], MODEL)
    np.testing.assert_allclose(choice.level, photo_choice._LEVEL_RANGE[1], rtol=1e-6)
