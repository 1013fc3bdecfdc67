"""The page shows what was measured, and needs nothing beside it."""

import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.lights import select_lights
from lambent_capture.loading.load import load_scene
from lambent_proto.v1 import evaluation_pb2
from lambent_run.report import figures
from lambent_run.report.page import grouped, write_page
from lambent_run.report.predictions import save_array
from PIL import Image
from support.captures import REFERENCES, write_blender
from support.predictions import write_predictions


class Page(HTMLParser):
    """Collects what a page shows and what it asks for."""

    def __init__(self, text):
        super().__init__()
        self.sources, self.captions, self.words, self._open = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._open.append(tag)
        self.sources += [value for name, value in attrs if name in ("src", "href") and value]

    def handle_data(self, data):
        if data.strip():
            (self.captions if self._open[-1] == "figcaption" else self.words).append(data.strip())


def page_of(tmp_path, folder, **changes):
    scene = load_scene(folder, select_lights(describe_scene(folder)), max_side=32)
    views = scene.test or scene.train
    write_predictions(tmp_path, scene, views)
    for view in views:
        shape = next(iter(view.images.values())).shape[:2]
        save_array(tmp_path / "pred" / view.name / "uncertainty.npy", np.full((*shape, 5), 0.2))
        error = np.full((*next(iter(view.images.values())).shape[:2], 3), 0.02)
        for light in (*scene.lights, *scene.relight_lights):
            save_array(tmp_path / "pred" / view.name / f"rgba_{light}_stderr.npy", error)
    report = evaluation_pb2.EvaluationReport(
        scene="a <b>scene</b>",
        preset="fast",
        protocol_version="1.0",
        metrics=[
            evaluation_pb2.Metric(name="nvs/psnr", value=30.125, unit="dB", standard_error=0.25),
            evaluation_pb2.Metric(name="albedo_rgb_ratio/ssim", value=0.9, unit="1"),
        ],
        protocol=["Pictures are compared.", "Normals: angles."],
        absent=[evaluation_pb2.AbsentMetric(name="nvs/lpips", reason="needs weights: give a <file>")],
        seconds={"cache": 110.4},
        **changes,
    )
    write_page(tmp_path / "report.html", report, tmp_path, scene, views, np.array([1.0, 2.0, 1.5]))
    return Page((tmp_path / "report.html").read_text())


def test_the_page_needs_no_other_file_and_no_network(tmp_path):
    page = page_of(tmp_path, REFERENCES / "scenes" / "tensoir_synthetic")
    assert page.sources
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not re.search(r"https?://|@import|url\(", (tmp_path / "report.html").read_text())


def test_every_kind_of_picture_is_shown_beside_its_truth(tmp_path):
    page = page_of(tmp_path, REFERENCES / "scenes" / "tensoir_synthetic")
    for caption in (
        "photograph, venice_sunset_000",
        "physically based",
        "error, physically based",
        "noise, physically based",
        "noise, relit, studio_small_05",
        "cache",
        "albedo, scaled",
        "true albedo",
        "normal",
        "true normal",
        "roughness",
        "true roughness",
        "metalness",
        "true metalness",
        "uncertainty of albedo",
        "of it, owed to the light",
        "uncertainty of perceptual roughness",
        "photographs that see it",
        "truth, studio_small_05",
        "relit, studio_small_05",
        "relit, direct light only",
    ):
        assert caption in page.captions


def test_a_scene_without_truth_gets_a_page_too(tmp_path):
    page = page_of(tmp_path / "out", write_blender(tmp_path / "scene"))
    assert "physically based" in page.captions
    assert "true albedo" not in page.captions


def test_the_page_prints_figures_with_error_and_unit_the_protocol_and_why_others_are_absent(tmp_path):
    words = page_of(tmp_path, REFERENCES / "scenes" / "tensoir_synthetic", albedo_ratio_rgb=[1, 2, 1.5]).words
    assert words[words.index("nvs/psnr") :][:4] == ["nvs/psnr", "30.125", "0.250", "dB"]
    assert any("1.0000, 2.0000, 1.5000" in word for word in words)
    assert any("cache 110 s" in word for word in words)
    assert any("docs/reference/protocol.md" in word for word in words)
    assert {"Pictures are compared.", "Normals: angles.", "The protocol, version 1.0, in short"} <= set(words)
    # What comes from a scene, or in a reason, is not markup.
    assert "a <b>scene</b>" in words
    assert words[words.index("nvs/lpips") + 1] == "needs weights: give a <file>"


def test_published_figures_stand_beside_ours(tmp_path):
    published = [
        evaluation_pb2.PublishedResult(method="TensoIR", values={"nvs/psnr": 34.7, "nvs/ssim": 0.968})
    ]
    folder = REFERENCES / "scenes" / "tensoir_synthetic"
    words = page_of(tmp_path, folder, published=published).words
    assert words[words.index("TensoIR") :][:3] == ["TensoIR", "34.700", "0.968"]
    assert words[words.index("this run (fast)") :][:3] == ["this run (fast)", "30.125", "–"]
    assert "TensoIR" not in page_of(tmp_path / "other", folder).words


def test_every_metric_has_a_place_on_the_page():
    names = [
        "nvs/psnr",
        "relight_direct/ssim",
        "albedo_interior/psnr_gamma",
        "rgb/sun/psnr",
        "distance/mean_abs",
    ]
    rows = [evaluation_pb2.Metric(name=name) for name in names]
    assert sorted(row.name for _, group in grouped(rows) for row in group) == sorted(names)


def test_pictures_are_reduced_and_never_enlarged():
    assert Image.open(io.BytesIO(figures.png(np.zeros((600, 300, 3))))).size == (128, 256)
    assert Image.open(io.BytesIO(figures.png(np.zeros((10, 20, 3))))).size == (20, 10)


@pytest.mark.parametrize("value", [0.0, 0.3, 1.0, 2.0])
def test_heat_is_brighter_where_the_error_is_larger(value):
    colours = figures.heat(np.array([[value, value + 0.1]]))
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0
    assert colours[0, 1].sum() >= colours[0, 0].sum()


def test_an_error_map_is_black_where_pictures_agree():
    picture = np.random.default_rng(0).random((4, 5, 3))
    np.testing.assert_allclose(figures.error_map(picture, picture), figures.heat(np.zeros((4, 5))))


def test_a_sheet_has_room_for_pictures_of_different_sizes():
    black = [np.zeros((4, 6, 3)), np.zeros((8, 3, 3))]
    sheet = figures.contact_sheet([black[:1], black])
    assert sheet.shape == (2 * 8 + 4, 2 * 6 + 4, 3)
    assert (sheet == 0.0).sum() == 3 * (2 * 4 * 6 + 8 * 3)
    assert sheet[12, 10:13].max() == 0.0


def test_maps_are_white_beside_the_object():
    alpha = np.zeros((2, 2, 1))
    np.testing.assert_array_equal(figures.normal_map(np.full((2, 2, 3), -1.0), alpha), 1.0)
    np.testing.assert_array_equal(figures.grey_map(np.zeros((2, 2, 1)), alpha), 1.0)
