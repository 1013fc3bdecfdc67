"""Every ablation is a change of settings that keeps stage one and the budget of secondary rays."""

import pytest
from flashcache.ablations import ABLATIONS, ablation_settings
from flashcache.config import Config, with_overrides
from flashcache.errors import ConfigError
from flashcache.physical.estimator import DirectionCounts
from flashcache.presets import PRESETS, fast, paper_tensoir


def ablated(config: Config, name: str) -> Config:
    return with_overrides(config, ablation_settings(config, name))


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("name", ABLATIONS)
def test_an_ablation_changes_stage_two_only(preset: str, name: str):
    config = PRESETS[preset]()
    changed = ablated(config, name)
    assert (changed.model, changed.stage_one, changed.pixels) == (
        config.model,
        config.stage_one,
        config.pixels,
    )


def test_the_rows_of_the_papers_table_switch_off_one_part_after_another():
    config = paper_tensoir()
    rows = [ablated(config, name).stage_two for name in ("full", "no_control_variate", "no_sampler", "depth")]
    assert [row.estimator.control_variate for row in rows] == ["on", "off", "off", "off"]
    assert [row.estimator.sampler for row in rows] == ["vmf", "vmf", "none", "none"]
    assert [row.points for row in rows] == ["categorical"] * 3 + ["depth"]
    assert rows[0] == config.stage_two


def test_all_ablations_but_k1_and_the_full_method_differ():
    config = fast()
    settings = [str(ablated(config, name)) for name in ABLATIONS]
    # K = 1, one of the two gradient factors and one state of the polish are what the preset has.
    assert len(set(settings)) == len(settings) - 3


@pytest.mark.parametrize("count", [1, 2, 4, 8])
@pytest.mark.parametrize("preset", ["fast", "paper_tensoir"])
def test_more_points_per_ray_share_the_same_fast_directions(preset: str, count: int):
    config = PRESETS[preset]()
    changed = ablated(config, f"k{count}").stage_two
    assert changed.points_per_ray == count
    assert count * changed.estimator.fast.total == config.stage_two.estimator.fast.total


def test_the_papers_k_keeps_the_papers_division():
    totals = [ablated(paper_tensoir(), f"k{k}").stage_two.estimator for k in (2, 4, 8)]
    assert [estimator.fast for estimator in totals] == [DirectionCounts.split(n) for n in (32, 16, 8)]
    assert [estimator.exact for estimator in totals[:2]] == [DirectionCounts.split(n) for n in (8, 4)]
    # Two exact directions are the fewest: one of each half.
    assert totals[2].exact == DirectionCounts(cosine=1, sampler=0, specular=1)


def test_an_unknown_ablation_is_answered_with_the_known_ones():
    with pytest.raises(ConfigError, match="no_sampler"):
        ablation_settings(fast(), "k3")
