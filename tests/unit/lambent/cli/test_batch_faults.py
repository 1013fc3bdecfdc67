"""lambent batch when something goes wrong: stopped, killed, cut off, or changed under its feet."""

import os
import signal
import subprocess
import sys
import time

import pytest
from lambent_relight import load_environment
from lambent_relight.batch.journal import open_journal
from lambent_relight.batch.plan import make_plan
from lambent_relight.batch.pool import attempt
from lambent_relight.batch.reading import read_manifest
from lambent_relight.batch.studio import Studio
from support.small_batch import ONE_PICTURE, SMALL, batch, states, table, write_inputs


@pytest.fixture
def folder(tmp_path):
    """Return a folder with a bundle of one grey ball, two maps, and nothing else."""
    return write_inputs(tmp_path)


def test_a_second_batch_in_the_same_folder_is_refused(folder, capsys):
    with open_journal(folder / "out"):
        assert batch(folder, SMALL) == 2
    assert "batch.folder_in_use" in capsys.readouterr().err


def test_a_line_that_was_cut_off_costs_one_picture_and_a_strange_file_nothing_else(folder, capsys):
    assert batch(folder, SMALL) == 0
    journal = folder / "out" / "pictures.jsonl"
    text = journal.read_text()
    journal.write_text(text[:-20])
    assert batch(folder, SMALL) == 0
    assert sorted(states(folder).values()) == ["kept", "made"]
    journal.write_text('{"path": 1}\n')
    assert batch(folder, SMALL) == 2
    assert "batch.bad_journal" in capsys.readouterr().err


def test_half_files_of_a_killed_batch_are_removed(folder):
    place = folder / "out/ball/sky/refined"
    place.mkdir(parents=True)
    (place / ".partial-1-turntable_000.png").write_bytes(b"half")
    assert batch(folder, SMALL) == 0
    assert not list((folder / "out").rglob(".partial*"))


@pytest.mark.parametrize(
    ("name", "code"), [("ball/manifest.json", "bundle.changed"), ("sky.exr", "environment.changed")]
)
def test_what_changes_under_a_running_batch_fails_its_pictures(folder, name, code):
    manifest = read_manifest(ONE_PICTURE, folder)
    plan = make_plan(manifest)
    with (folder / name).open("ab") as file:
        file.write(b" ")
    assert attempt(Studio(folder / "out", manifest.files), plan.rows[0], ("png",)).code == code


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_ctrl_c_keeps_what_is_done_and_leaves_no_half_file(folder, jobs):
    (folder / "m.yaml").write_text(SMALL.replace("turntable: 2, size: 8", "turntable: 300, size: 48"))
    command = [sys.executable, "-m", "lambent", "batch", str(folder / "m.yaml"), "-o", str(folder / "out")]
    child = subprocess.Popen([*command, "--jobs", jobs], stderr=subprocess.PIPE, start_new_session=True)
    journal = folder / "out" / "pictures.jsonl"
    deadline = time.monotonic() + 60
    while time.monotonic() < deadline and not (journal.is_file() and journal.read_text().count("\n") >= 3):
        time.sleep(0.05)
    os.killpg(child.pid, signal.SIGINT)
    _, err = child.communicate(timeout=30)
    assert child.returncode == 130, err.decode()
    done = journal.read_text().count("\n")
    assert 3 <= done < 300
    assert not list((folder / "out").rglob(".partial*"))
    assert len(states(folder)) <= done
    text = SMALL.replace("turntable: 2, size: 8", "turntable: 300, size: 48")
    with open_journal(folder / "out") as known:
        assert len(known.records) == done
    assert batch(folder, text, "--dry-run") == 0
    assert load_environment(folder / "sky.exr")


@pytest.mark.slow
def test_a_process_that_dies_fails_one_picture_and_is_replaced(folder, monkeypatch):
    """The second picture's camera kills whoever renders it."""
    (folder / "die.py").write_text(
        "import os, lambent_relight.batch.studio as studio\n"
        "make = studio.Studio.make\n"
        "def fatal(self, row, suffixes, progress=None):\n"
        "    if row.camera.name.endswith('_001'):\n"
        "        os.kill(os.getpid(), 9)\n"
        "    return make(self, row, suffixes, progress)\n"
        "studio.Studio.make = fatal\n"
    )
    (folder / "sitecustomize.py").write_text("import die\n")
    monkeypatch.setenv("PYTHONPATH", str(folder))
    (folder / "m.yaml").write_text(SMALL.replace("turntable: 2", "turntable: 6"))
    command = [sys.executable, "-m", "lambent", "batch", str(folder / "m.yaml"), "-o", str(folder / "out")]
    done = subprocess.run([*command, "--jobs", "2"], capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 1, done.stderr
    found = states(folder)
    assert found.pop("ball/sky/refined/turntable_001") == "failed"
    assert table(folder)["ball/sky/refined/turntable_001"]["code"] == "batch.worker_died"
    assert set(found.values()) == {"made"}
    assert len(found) == 5
