"""`lambent masks` writes masks that the other commands take, by the estimate or by a user's segmenter."""

import json

import numpy as np
import pytest
import typer
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.loading.inspect import inspect_files
from lambent_capture.masks.folder import write_masks as write_masks_of
from lambent_capture.masks.segmenter import find_segmenter
from lambent_capture.pictures.mask_levels import read_mask
from lambent_core.errors import UsageError
from lambent_proto.v1 import scene_pb2
from lambent_run.commands import check as check_cli
from lambent_run.commands import masks as masks_cli
from PIL import Image
from support.ball_photographs import write_ball_photographs, write_masks
from support.ball_views import SIDE
from typer.testing import CliRunner

from benchmarks.painted_scene import overlap


def call(command, *arguments):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command()(command)
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def red_is_the_object(views):
    """A segmenter: what is redder than blue."""
    return [(view.image_srgb[..., 0] > view.image_srgb[..., 2].astype(int) + 20) * 1.0 for view in views]


def one_mask_too_few(views):
    return red_is_the_object(views)[1:]


def masks_of_half_the_size(views):
    return [mask[::2] for mask in red_is_the_object(views)]


@pytest.mark.slow
def test_estimated_masks_are_right_and_are_taken_by_the_check(tmp_path):
    true = write_ball_photographs(tmp_path / "scene")
    result = call(masks_cli.masks, tmp_path / "scene", "-o", tmp_path / "out")
    assert result.exit_code == 0
    assert f'--masks "{tmp_path / "out" / "masks"}"' in result.stdout
    assert "scene.no_mask" in call(check_cli.check, tmp_path / "scene").stdout
    for name, mask in true.items():
        found = read_mask(tmp_path / "out" / "masks" / f"{name}.png").coverage
        assert overlap(found, mask.astype(float)) > 0.9
    checked = call(check_cli.check, tmp_path / "scene", "--masks", tmp_path / "out" / "masks", "--json")
    record = json.loads(checked.stdout)
    assert record["usable"]
    assert record["figures"]["has_masks"]
    assert "scene.no_mask" not in {finding["code"] for finding in record["findings"]}


def test_somebody_elses_segmenter_is_called_with_cameras_and_pictures(tmp_path):
    true = write_ball_photographs(tmp_path / "scene")
    name = f"{__name__}:red_is_the_object"
    result = call(masks_cli.masks, tmp_path / "scene", "-o", tmp_path / "out", "--segmenter", name, "--json")
    assert json.loads(result.stdout)["masks"] == str(tmp_path / "out" / "masks")
    found = read_mask(tmp_path / "out" / "masks" / "train_r_3.png").coverage
    assert (found[true["train_r_3"]] == 1).mean() > 0.95
    assert (found[~true["train_r_3"]] == 0).all()


@pytest.mark.parametrize(
    ("segmenter", "code"),
    [
        (f"{__name__}:one_mask_too_few", "scene.mask_file_missing"),
        (f"{__name__}:masks_of_half_the_size", "scene.mask_size"),
    ],
)
def test_a_segmenter_that_returns_something_else_is_told_what(tmp_path, segmenter, code):
    write_ball_photographs(tmp_path / "scene", count=4)
    result = call(masks_cli.masks, tmp_path / "scene", "-o", tmp_path / "out", "--segmenter", segmenter)
    assert result.exit_code == 1
    assert code in result.stderr


@pytest.mark.parametrize("name", ["nobody", "no_such_module:f", f"{__name__}:no_such", "json:__name__"])
def test_a_segmenter_that_is_not_there_is_a_usage_error(name):
    with pytest.raises(UsageError, match=r"config\.segmenter_unknown"):
        find_segmenter(name)


def test_pictures_without_an_object_are_refused_with_advice(tmp_path):
    write_ball_photographs(tmp_path / "scene", count=12)
    for path in (tmp_path / "scene" / "train").iterdir():
        Image.new("RGB", (SIDE, SIDE), (90, 90, int(path.stem[2:]))).save(path)
    result = call(masks_cli.masks, tmp_path / "scene", "-o", tmp_path / "out")
    assert result.exit_code == 4
    assert "scene.mask_missing" in result.stderr
    assert "--masks" in result.stderr
    assert "masks.jpg" in result.stderr
    assert len(list((tmp_path / "out" / "masks").glob("*.png"))) == 12
    with Image.open(tmp_path / "out" / "masks.jpg") as image:
        assert (np.asarray(image)[:14].astype(int) - [190, 0, 0]).__abs__().max(axis=-1).min() < 60


DAMAGES = {
    "scene.mask_file_missing": lambda path: path.unlink(),
    "scene.image_not_a_picture": lambda path: path.write_text("no picture"),
    "scene.image_broken": lambda path: path.write_bytes(path.read_bytes()[:60]),
    "scene.mask_empty": lambda path: Image.new("L", (SIDE, SIDE)).save(path),
    "scene.mask_size": lambda path: Image.new("L", (SIDE, 2 * SIDE), 255).save(path),
}


@pytest.mark.parametrize(("code", "damage"), DAMAGES.items(), ids=DAMAGES)
def test_each_damage_to_a_mask_is_one_finding_with_file_and_frame(tmp_path, code, damage):
    folder = tmp_path / "scene"
    masks = write_masks(folder / "cut", write_ball_photographs(folder))
    damage(masks / "train_r_5.png")
    findings = inspect_files(folder, masks=masks).report.findings
    (finding,) = (f for f in findings if f.severity == scene_pb2.SEVERITY_ERROR)
    assert finding.code == code
    assert "train_r_5" in finding.message
    assert finding.subject in ("cut/train_r_5.png", "train_r_5")


def test_the_sheet_shows_every_frame_and_dims_what_was_cut_off(tmp_path):
    true = write_ball_photographs(tmp_path, count=9)

    def truth(views):
        return [true[view.name].astype(float) for view in views]

    written = write_masks_of(tmp_path, describe_scene(tmp_path), tmp_path / "out", truth)
    with Image.open(written.sheet) as image:
        assert image.size == (8 * (SIDE + 4), 2 * (SIDE + 4 + 14))
        sheet = np.asarray(image).astype(int)
    assert (np.abs(sheet - [230, 0, 160]).max(axis=-1) < 60)[:, : SIDE + 4].sum() > 40
    assert np.abs(sheet[1, 1] - (0.4 * np.array([120, 125, 130]) + 0.6 * 176)).max() < 6
