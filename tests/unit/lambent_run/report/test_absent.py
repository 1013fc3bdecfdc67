"""A figure that a report lacks is named, with what to do about it."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from lambent_run.report.absent import absent_metrics
from lambent_run.report.request import Subject
from support.evaluation_subject import subject_of
from support.lit_sphere import lit_domain, lit_sphere

SCENE = replace(lit_sphere(2, side=4), relight_lights=("city", "night"))
TRUTH = {"albedo": np.zeros((4, 4, 4), np.float32), "normal": np.zeros((4, 4, 4), np.float32)}
VIEWS = tuple(replace(view, truth=TRUTH) for view in SCENE.test)
MAP = np.ones((2, 4, 3), np.float32)


def subject(**changes: Any) -> Subject:
    given = {
        "model": SimpleNamespace(domain=lit_domain(SCENE)),
        "scene": SCENE,
        "views": VIEWS,
        "maps": {"city": MAP, "night": MAP},
        "lpips": cast(Any, object()),
        "uncertainty": cast(Any, object()),
        "true_lights": {"sky": MAP},
    }
    return subject_of(**{**given, **changes})


def reasons(given: Subject, *found: str) -> dict[str, str]:
    return {row.name: row.reason for row in absent_metrics(given, found)}


def test_a_whole_evaluation_lacks_nothing():
    assert reasons(subject(), "nvs/psnr", "nvs/ssim") == {}


def test_without_weights_every_group_says_how_to_get_lpips():
    found = reasons(subject(lpips=None), "nvs/ssim", "albedo_rgb_ratio/ssim", "nvs/psnr", "rgb/city/ssim")
    assert set(found) == {"nvs/lpips", "albedo_rgb_ratio/lpips"}
    assert all("--lpips-weights" in reason for reason in found.values())


@pytest.mark.parametrize(
    ("changes", "name", "word"),
    [
        ({"views": SCENE.test}, "albedo_rgb_ratio/psnr_gamma", "albedo"),
        ({"views": SCENE.test}, "normal/mae_all", "normals"),
        ({"held_out": False}, "nvs/psnr", "test views"),
        ({"uncertainty": None}, "uncertainty/albedo_rank_correlation", "surface"),
        ({"maps": {}}, "relight/psnr", "--environments"),
        ({"maps": {"city": MAP}}, "rgb/night/psnr", "--environments"),
        ({"true_lights": {}}, "environment/log_rmse", "envmaps/sky.hdr"),
        ({"scene": lit_sphere(2, side=4)}, "relight/psnr", "other light"),
        ({"dataset": "openillumination"}, "relight/psnr", "several lights"),
        (
            {"dataset": "openillumination", "scene": replace(SCENE, lights=("a", "b"))},
            "nvs/psnr",
            "one light",
        ),
    ],
)
def test_what_is_missing_is_named_with_its_reason(changes, name, word):
    assert word in reasons(subject(**changes))[name]


def lit(**domain: Any) -> SimpleNamespace:
    return SimpleNamespace(domain=replace(lit_domain(SCENE), **domain))


def test_a_light_that_was_given_or_turned_is_said_to_be():
    given = reasons(subject(model=lit(known_lights=("sky",))))
    assert "--known-light" in given["environment/log_rmse"]
    two = {"scene": replace(SCENE, lights=("sky", "lamp")), "model": lit(known_lights=("lamp",))}
    found = reasons(subject(**two), "environment/log_rmse")
    assert "--known-light" in found["environment/lamp/log_rmse"]
    turning = tuple(replace(view, light_turn=np.eye(3)) for view in SCENE.train)
    turned = reasons(subject(scene=replace(SCENE, train=turning)))
    assert "turned" in turned["environment/log_rmse"]


def test_a_figure_that_is_there_is_not_called_absent():
    assert "nvs/psnr" not in reasons(subject(held_out=False), "nvs/psnr")
