"""The check runs in a child process that survives what would kill it, or dies alone."""

import base64
import io
import json
import resource
import subprocess
import sys

import numpy as np
import pytest
from lambent_worker.capture_qa import check
from lambent_worker.errors import UsageError
from lambent_worker.scenes.detect import describe_scene
from PIL import Image
from support.captures import save, write_blender, write_tensoir
from support.hostile_files import huge_exr, huge_png

pytestmark = pytest.mark.slow

MEGABYTE = 2**20


def test_the_child_reports_what_looking_in_this_process_would(tmp_path):
    folder = write_tensoir(tmp_path)
    (folder / "train_000" / "rgba_sunset.png").write_text("no picture")
    report = check.check_capture(folder).report
    assert not report.usable
    assert {finding.code for finding in report.findings} == {"scene.image_not_a_picture"}
    assert report.layout == "tensoir_synthetic"


def test_a_capture_that_can_be_used_is_measured_with_masks_from_a_folder(tmp_path):
    folder = write_tensoir(tmp_path / "scene")
    mask = np.zeros((12, 12), dtype=np.uint8)
    mask[3:9, 3:6] = 255
    for path in folder.iterdir():
        save(tmp_path / "masks" / f"{path.name}.png", mask)
    checked = check.check_capture(folder, masks=tmp_path / "masks")
    assert checked.report.usable
    assert checked.figures.views[0].mask_share == pytest.approx(18 / 144)
    assert len(checked.thumbnails) == 7
    with Image.open(io.BytesIO(base64.b64decode(checked.portrait))) as portrait:
        assert portrait.format == "JPEG"


@pytest.mark.parametrize(
    "told", ["no base64", "", None, 7, "AAAA", "/9j/" + "A" * check.MAX_PORTRAIT_CHARACTERS]
)
def test_a_portrait_that_is_none_is_dropped(tmp_path, monkeypatch, told):
    lines = f'portrait {json.dumps(told)}\nreport {{"usable": true}}\n'
    answer = subprocess.CompletedProcess((), 0, stdout=lines)
    monkeypatch.setattr(check.subprocess, "run", lambda *given, **options: answer)
    assert check.check_capture(tmp_path).portrait == ""


def test_this_process_keeps_its_own_limits(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_AS)
    check.check_capture(write_tensoir(tmp_path))
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def test_an_unknown_layout_is_a_usage_error_before_any_child_starts(tmp_path):
    with pytest.raises(UsageError):
        check.check_capture(tmp_path, "polaroid")


def test_a_child_without_enough_memory_ends_in_a_finding(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "MAX_MEMORY_BYTES", 30 * MEGABYTE)
    report = check.check_capture(write_tensoir(tmp_path)).report
    assert [finding.code for finding in report.findings] == ["scene.check_failed"]
    assert not report.usable


def dying_at(killer):
    """Return `subprocess.run` of a child that dies when it decodes `killer`."""
    real = subprocess.run

    def run(command, *, input, **options):
        script = (
            "import sys, os, lambent_worker.scenes.inspect as i\n"
            "real = i.picture_facts\n"
            f"i.picture_facts = lambda p: os.abort() if str(p).endswith({killer!r}) else real(p)\n"
            "import lambent_worker.capture_qa.check_child as c\n"
            "c.main()\n"
        )
        return real([sys.executable, "-I", "-c", script], input=input, **options)

    return run


def test_a_file_that_kills_the_child_is_named_and_the_rest_is_still_checked(tmp_path, monkeypatch):
    folder = write_tensoir(tmp_path)
    (folder / "train_001" / "rgba_sunset.png").write_text("no picture")
    killer = "train_002/rgba_sunset.png"
    monkeypatch.setattr(check.subprocess, "run", dying_at(killer))
    report = check.check_capture(folder).report
    found = {finding.code: finding.subject for finding in report.findings}
    assert found["scene.image_too_large"] == killer
    assert found["scene.image_not_a_picture"] == "train_001/rgba_sunset.png"


def test_a_file_that_kills_the_child_is_left_out_where_others_make_up_for_it(tmp_path, monkeypatch):
    folder = write_blender(tmp_path)
    monkeypatch.setattr(check.subprocess, "run", dying_at("train/r_2.png"))
    checked = check.check_capture(folder)
    assert checked.report.usable
    assert checked.left_out == ("train/r_2.png",)
    assert checked.figures.num_train_views == 4
    described = describe_scene(folder, left_out=checked.left_out)
    assert [view.name for view in checked.figures.views] == [frame.name for frame in described.frames]


def test_a_child_that_takes_too_long_ends_in_a_finding(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "MAX_WALL_S", 0.05)
    report = check.check_capture(write_tensoir(tmp_path)).report
    assert [finding.code for finding in report.findings] == ["scene.check_failed"]


def test_the_limits_forbid_files_and_memory():
    script = (
        "from lambent_worker.capture_qa.check_child import limit_resources\n"
        "import tempfile\n"
        "limit_resources(512 * 2**20, 60)\n"
        "try:\n    bytearray(2**30)\n    print('memory')\nexcept MemoryError:\n    pass\n"
        "try:\n    f = tempfile.TemporaryFile(); f.write(b'x' * 10**6); f.flush(); print('file')\n"
        "except OSError:\n    pass\n"
        "print('done')\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["done"]


def test_hostile_pictures_do_not_need_much_memory_or_time(tmp_path):
    folder = write_tensoir(tmp_path)
    huge_png(folder / "train_000" / "rgba_sunset.png", 8000)
    huge_exr(folder / "test_000" / "distance.exr", 4000)
    # In a process of its own: the largest child of this one may be another test's.
    program = (
        "import resource, sys; from pathlib import Path; "
        "from lambent_worker.capture_qa.check import check_capture; "
        "usable = check_capture(Path(sys.argv[1])).report.usable; "
        "use = resource.getrusage(resource.RUSAGE_CHILDREN); "
        "print(usable, use.ru_maxrss, use.ru_utime)"
    )
    command = [sys.executable, "-c", program, folder]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    usable, size_kib, seconds = output.split()
    assert usable == "False"
    assert int(size_kib) < 512 * 1024
    assert float(seconds) < 5.0
