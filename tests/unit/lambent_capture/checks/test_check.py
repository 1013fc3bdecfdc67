"""The check runs in a child process that survives what would kill it, or dies alone."""

import base64
import io
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
from lambent_capture.checks import check
from lambent_capture.layouts.detect import describe_scene
from lambent_capture.problems import MAX_FINDINGS
from lambent_core.errors import UsageError, WorkerError
from lambent_sandbox import sandbox
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
    monkeypatch.setattr(check, "COMMAND", saying(lines))
    assert check.check_capture(tmp_path).portrait == ""


def test_this_process_keeps_its_own_limits(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_AS)
    check.check_capture(write_tensoir(tmp_path))
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def test_an_unknown_layout_is_a_usage_error_before_any_child_starts(tmp_path):
    with pytest.raises(UsageError):
        check.check_capture(tmp_path, "polaroid")


def test_a_child_without_enough_memory_ends_in_a_finding(tmp_path, monkeypatch):
    hoards = "import lambent_capture.checks.check_child as c; c.check = lambda *_: bytearray(2**32); c.main()"
    monkeypatch.setattr(check, "COMMAND", [sys.executable, "-B", "-c", hoards])
    report = check.check_capture(write_tensoir(tmp_path)).report
    assert [finding.code for finding in report.findings] == ["scene.check_failed"]
    assert not report.usable


def test_a_reader_that_raises_is_named_as_such(tmp_path, monkeypatch):
    raises = "import lambent_capture.checks.check_child as c; c.check = lambda *_: {}['fucal']; c.main()"
    monkeypatch.setattr(check, "COMMAND", [sys.executable, "-B", "-c", raises])
    (finding,) = check.check_capture(write_tensoir(tmp_path)).report.findings
    assert finding.code == "scene.check_failed"
    assert finding.message.startswith("the check failed with KeyError: 'fucal' (<string>:1)")
    assert "a fault of Lambent's reader" in finding.message
    # Foreign code may run in the child: what it says is cut, and has no control characters.
    says = f"print('failed', {json.dumps(json.dumps('x' * 1000 + chr(7)))})"
    monkeypatch.setattr(check, "COMMAND", [sys.executable, "-c", says])
    (finding,) = check.check_capture(tmp_path).report.findings
    assert len(finding.message) < 500
    assert finding.message.isprintable()


def test_a_library_that_cannot_be_loaded_is_no_fault_of_the_capture(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "MAX_MEMORY_BYTES", 30 * MEGABYTE)
    with pytest.raises(WorkerError, match="a library cannot be loaded: ImportError") as caught:
        check.check_capture(write_tensoir(tmp_path))
    assert caught.value.code == "run.check_broken"


def test_libraries_may_lie_elsewhere_than_those_of_python(tmp_path):
    folder = write_tensoir(tmp_path)
    program = (
        "import sys; from pathlib import Path; from lambent_capture.checks.check import check_capture; "
        "print(check_capture(Path(sys.argv[1])).report.usable)"
    )
    # As with `pip install --target`: the interpreter itself has none of them, PYTHONPATH has.
    bare = os.path.realpath(sys.executable)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    command = [bare, "-P", "-s", "-c", program, str(folder)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.stdout == "True\n", done.stderr


def saying(lines):
    """Return the command of a child that answers with these lines."""
    # Longer than an argument may be.
    told = base64.b64encode(zlib.compress(lines.encode())).decode()
    unpack = f"zlib.decompress(base64.b64decode({told!r})).decode()"
    return [sys.executable, "-c", f"import base64, sys, zlib; sys.stdin.read(); sys.stdout.write({unpack})"]


def at(killer, act):
    """Return the command of a child that runs `act` when it decodes `killer`."""
    script = (
        "import ctypes, os, socket, subprocess, sys, lambent_capture.loading.inspect as i\nreal = "
        f"i.picture_facts\ndef act(path):\n    {act}\n    return real(path)\ni.picture_facts = lambda p: "
        f"act(p) if str(p).endswith({killer!r}) else real(p)\nimport lambent_capture.checks.check_child as "
        "c\nc.main()\n"
    )
    return [sys.executable, "-B", "-c", script]


def test_a_file_that_kills_the_child_is_named_and_the_rest_is_still_checked(tmp_path, monkeypatch):
    folder = write_tensoir(tmp_path)
    (folder / "train_001" / "rgba_sunset.png").write_text("no picture")
    killer = "train_002/rgba_sunset.png"
    monkeypatch.setattr(check, "COMMAND", at(killer, "os.abort()"))
    report = check.check_capture(folder).report
    found = {finding.code: finding.subject for finding in report.findings}
    assert found["scene.image_too_large"] == killer
    assert found["scene.image_not_a_picture"] == "train_001/rgba_sunset.png"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_ctrl_c_is_no_fault_of_the_file_that_is_being_read(tmp_path, monkeypatch, name):
    """It reaches the child too; the command that runs the check decides what happens."""
    folder = write_tensoir(tmp_path)
    act = f"import signal; signal.raise_signal(signal.{name})"
    monkeypatch.setattr(check, "COMMAND", at("train_002/rgba_sunset.png", act))
    report = check.check_capture(folder).report
    assert report.usable
    assert not [finding for finding in report.findings if finding.subject == "train_002/rgba_sunset.png"]


def test_a_command_that_is_interrupted_ends_its_check_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "COMMAND", [sys.executable, "-c", "import time; time.sleep(60)"])
    began = time.monotonic()
    timer = threading.Timer(0.3, signal.pthread_kill, (threading.get_ident(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        check.check_capture(write_tensoir(tmp_path))
    assert time.monotonic() - began < 4.0


def test_a_file_that_kills_the_child_is_left_out_where_others_make_up_for_it(tmp_path, monkeypatch):
    folder = write_blender(tmp_path)
    monkeypatch.setattr(check, "COMMAND", at("train/r_2.png", "os.abort()"))
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


ATTACKS = {
    "network": "socket.socket()",
    "a new file": "open('/tmp/lambent-attack', 'w')",
    "removing": "os.unlink(path)",
}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have limits only")
@pytest.mark.parametrize("attack", ATTACKS)
def test_a_picture_whose_reader_is_taken_over_is_named_and_left_out(tmp_path, monkeypatch, attack):
    folder = write_blender(tmp_path)
    monkeypatch.setattr(check, "COMMAND", at("train/r_2.png", ATTACKS[attack]))
    checked = check.check_capture(folder)
    assert checked.left_out == ("train/r_2.png",)
    assert (folder / "train" / "r_2.png").exists()
    assert not Path("/tmp/lambent-attack").exists()
    every = describe_scene(write_blender(tmp_path / "whole"))
    assert checked.figures.num_train_views == sum(f.split == 1 for f in every.frames) - 1


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have limits only")
def test_a_reader_that_is_taken_over_is_told_with_a_code_of_its_own(tmp_path, monkeypatch):
    folder = write_tensoir(tmp_path)
    killer = "train_002/rgba_sunset.png"
    monkeypatch.setattr(check, "COMMAND", at(killer, ATTACKS["network"]))
    report = check.check_capture(folder).report
    found = {finding.code: finding.subject for finding in report.findings}
    assert found["scene.decoder_stopped"] == killer


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have limits only")
def test_a_reader_sees_no_file_but_those_of_the_capture(tmp_path, monkeypatch):
    folder = write_blender(tmp_path / "scene")
    secret = tmp_path / "api.key"
    secret.write_text("secret")
    look = f"print('report', '{{\"usable\": true}}') if open({str(secret)!r}).read() == 'secret' else None"
    monkeypatch.setattr(check, "COMMAND", at("train/r_2.png", look))
    # What cannot be opened ends the reader.
    assert check.check_capture(folder).left_out == ("train/r_2.png",)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have limits only")
def test_a_folder_that_python_starts_in_is_not_part_of_the_program(tmp_path):
    """`python -m` puts the working directory into `sys.path`, which the child gets."""
    folder = write_blender(tmp_path / "scene")
    secret = tmp_path / "api.key"
    secret.write_text("secret")
    look = f"open({str(secret)!r})"
    program = (
        "from pathlib import Path\nfrom lambent_capture.checks import check\ncheck.COMMAND = "
        f"{at('train/r_2.png', look)!r}\nprint(check.check_capture(Path({str(folder)!r})).left_out)\n"
    )
    (tmp_path / "starts_check.py").write_text(program)
    command = [sys.executable, "-m", "starts_check"]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout == "('train/r_2.png',)\n"


def test_a_capture_among_the_program_is_refused_before_a_child_starts(tmp_path, monkeypatch):
    monkeypatch.setattr(sandbox, "program_paths", lambda: [tmp_path])
    monkeypatch.setattr(check, "COMMAND", ["/nowhere"])
    if sys.platform.startswith("linux"):
        with pytest.raises(WorkerError, match="move it elsewhere") as caught:
            check.check_capture(write_blender(tmp_path / "scene"))
        assert caught.value.code == "run.sandbox_missing"
    monkeypatch.setenv("LAMBENT_SANDBOX", "limits")
    with pytest.raises(FileNotFoundError):
        check.check_capture(tmp_path)


LIES = {
    "a device": ["/dev/zero"],
    "a folder above": ["../.."],
    "a file above": ["../api.key"],
    "the folder": ["."],
    "a folder": ["train"],
    "nothing": ["train/no.png"],
    "a link out": ["link.png"],
    "a file through a link": ["linked/api.key"],
    "a long name": ["a" * 5000],
    "a zero": ["a\0b"],
    "a surrogate": ["\ud800"],
    "a number": [3],
    "a text": "train",
}


@pytest.mark.timeout(60)
@pytest.mark.parametrize("lie", LIES)
def test_pictures_that_are_none_are_not_left_out(tmp_path, monkeypatch, lie):
    folder = tmp_path / "scene"
    (folder / "train").mkdir(parents=True)
    (folder / "train" / "a.png").write_bytes(b"a")
    (tmp_path / "api.key").write_text("secret")
    (folder / "link.png").symlink_to(tmp_path / "api.key")
    (folder / "linked").symlink_to(tmp_path)
    (folder / "inside.png").symlink_to(folder / "train" / "a.png")
    report = 'report {"usable": true}\n'
    monkeypatch.setattr(check, "COMMAND", saying(f"left_out {json.dumps(LIES[lie])}\n{report}"))
    checked = check.check_capture(folder)
    assert (checked.report.usable, checked.left_out) == (False, ())
    assert "scene.decoder_stopped" in {each.code for each in checked.report.findings}
    # Links to files of the capture are what a capture may have.
    truth = ["train/a.png", "inside.png"]
    monkeypatch.setattr(check, "COMMAND", saying(f"left_out {json.dumps(truth)}\n{report}"))
    assert check.check_capture(folder).left_out == tuple(truth)


@pytest.mark.parametrize(("strictness", "code"), [("required", 0), ("available", 3), ("limits", 3)])
def test_a_refusal_that_nobody_asked_for_is_not_believed(tmp_path, monkeypatch, strictness, code):
    monkeypatch.setenv("LAMBENT_SANDBOX", strictness)
    command = saying('refused "because"\n')
    monkeypatch.setattr(check, "COMMAND", [*command[:-1], f"{command[-1]}; sys.exit({code})"])
    report = check.check_capture(tmp_path).report
    assert {each.code for each in report.findings} == {"scene.decoder_stopped", "scene.check_failed"}


@pytest.mark.parametrize("more", [0, 1])
def test_more_findings_than_a_check_has_are_not_believed(tmp_path, monkeypatch, more):
    told = {"usable": True, "findings": [{"code": "scene.image_duplicate"}] * (MAX_FINDINGS + more)}
    monkeypatch.setattr(check, "COMMAND", saying(f"report {json.dumps(told)}\n"))
    assert check.check_capture(tmp_path).report.usable is not bool(more)


@pytest.mark.parametrize(
    "lines",
    [
        "report {\n",
        "report []\n",
        "thumbnail 7\n",
        "figures x\n",
        "left_out 3\n",
        "reading {\n",
        'broken "everything"\n',
        "\xff\0",
    ],
)
def test_an_answer_that_no_check_gives_ends_in_a_finding(tmp_path, monkeypatch, lines):
    monkeypatch.setattr(check, "COMMAND", saying('reading "a.png"\n' + lines))
    report = check.check_capture(tmp_path).report
    assert not report.usable
    assert "scene.check_failed" in {each.code for each in report.findings}


def test_an_endless_answer_ends_in_a_finding(tmp_path, monkeypatch):
    monkeypatch.setattr(check, "MAX_OUTPUT_BYTES", 1000)
    monkeypatch.setattr(check, "COMMAND", [sys.executable, "-c", "while True: print('x')"])
    assert not check.check_capture(tmp_path).report.usable


def test_a_sandbox_that_is_required_and_missing_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("LAMBENT_SANDBOX", "required")
    without = "import lambent_sandbox.filters as f; f.install = lambda rules: 'no such thing'; "
    run = "import lambent_capture.checks.check_child as c; c.main()"
    monkeypatch.setattr(check, "COMMAND", [sys.executable, "-B", "-c", without + run])
    with pytest.raises(WorkerError, match="no such thing") as caught:
        check.check_capture(write_blender(tmp_path))
    assert caught.value.code == "run.sandbox_missing"


def test_a_strictness_that_does_not_exist_is_a_usage_error(tmp_path, monkeypatch):
    monkeypatch.setenv("LAMBENT_SANDBOX", "strict")
    with pytest.raises(UsageError, match="required, available, limits"):
        check.check_capture(tmp_path)


def test_hostile_pictures_do_not_need_much_memory_or_time(tmp_path):
    folder = write_tensoir(tmp_path)
    huge_png(folder / "train_000" / "rgba_sunset.png", 8000)
    huge_exr(folder / "test_000" / "distance.exr", 4000)
    # In a process of its own: the largest child of this one may be another test's.
    program = (
        "import resource, sys; from pathlib import Path; from lambent_capture.checks.check import "
        "check_capture; usable = check_capture(Path(sys.argv[1])).report.usable; use = "
        "resource.getrusage(resource.RUSAGE_CHILDREN); print(usable, use.ru_maxrss, use.ru_utime)"
    )
    command = [sys.executable, "-c", program, folder]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    usable, size_kib, seconds = output.split()
    assert usable == "False"
    assert int(size_kib) < 512 * 1024
    assert float(seconds) < 5.0
