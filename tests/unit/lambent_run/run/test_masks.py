"""The masks of a run are part of its identity."""

import pytest
from lambent_core.errors import UsageError
from lambent_run.run.masks import masks_setting
from support.ball_photographs import write_masks
from support.ball_views import ball_views


@pytest.fixture
def masks(tmp_path):
    return write_masks(tmp_path / "cut", {f"v{i}": view.mask for i, view in enumerate(ball_views(3))})


def test_the_setting_follows_contents_and_not_places(tmp_path, masks):
    setting = masks_setting(masks, whole_view=False)
    masks.rename(tmp_path / "moved")
    assert masks_setting(tmp_path / "moved", whole_view=False) == setting
    (tmp_path / "moved" / "v1.png").write_bytes((tmp_path / "moved" / "v0.png").read_bytes() + b"\0")
    assert masks_setting(tmp_path / "moved", whole_view=False) != setting


def test_masks_and_no_masks_contradict_each_other(masks):
    with pytest.raises(UsageError, match=r"config\.masks_twice"):
        masks_setting(masks, whole_view=True)


@pytest.mark.parametrize("name", ["nowhere", "empty"])
def test_a_folder_without_masks_is_a_usage_error(tmp_path, name):
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match=r"config\.masks_missing"):
        masks_setting(tmp_path / name, whole_view=False)
