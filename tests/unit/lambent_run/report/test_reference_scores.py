"""Figures that pages quote, taken from the reference evaluation."""

from pathlib import Path

import pytest

from benchmarks import reference_scores


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    folders: list[str] = []

    def report(scene: Path, predictions: Path, views: int) -> dict[str, object]:
        folders.append(predictions.name)
        value = {"pred": 1.0, "pred_cache": 2.0, "pred_direct": 3.0}[predictions.name]
        return {
            "scene": "name",
            "views": 4,
            "nvs/psnr": value,
            "relight/psnr": value,
            "albedo_ratio": [1, 1, 1],
        }

    monkeypatch.setattr(reference_scores, "reference_report", report)
    return folders


def test_scores_leave_out_what_is_not_a_number(asked: list[str]):
    found = reference_scores.reference_scores(Path("scene"), Path("pred"), 4)
    assert found == {"views": 4.0, "nvs/psnr": 1.0, "relight/psnr": 1.0}


def test_every_figure_comes_from_its_own_folder(asked: list[str], tmp_path: Path):
    for name in ("pred", "pred_cache", "pred_direct"):
        (tmp_path / name).mkdir()
    assert reference_scores.figures_of(Path("scene"), tmp_path) == {
        "cache novel views [dB]": 2.0,
        "novel views [dB]": 1.0,
        "relit, direct only [dB]": 3.0,
        "relit [dB]": 1.0,
    }


def test_a_report_without_relit_pictures_has_no_figures_of_them(asked: list[str], tmp_path: Path):
    (tmp_path / "pred_cache").mkdir()
    assert reference_scores.figures_of(Path("scene"), tmp_path) == {"cache novel views [dB]": 2.0}
    assert asked == ["pred_cache"]
