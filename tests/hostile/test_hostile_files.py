"""Hostile files of every kind end in a clear answer: no tracebacks, no foreign calls, not too much memory."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import (
    hostile_archives,
    hostile_client,
    hostile_kinds,
    hostile_pictures,
    hostile_poses,
    mutations,
)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have no sandbox"),
]

MUTANTS = int(os.environ.get("LAMBENT_MUTANTS", "300"))
SEED = int(os.environ.get("LAMBENT_MUTANTS_SEED", "1"))
ATTACKED = Path("/tmp/lambent-attack")


def lines_of(script: object, *options: str) -> Iterator[dict]:
    """Yield the JSON objects that a program prints, in a process without threads: it is copied often."""
    command = [sys.executable, str(script), *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    for line in done.stdout.splitlines():
        yield json.loads(line) if line.startswith("{") else {"fault": line}


@pytest.fixture(scope="module")
def kinds() -> dict[str, dict]:
    """Return what became of every kind."""
    return {each.get("kind", str(each)): each for each in lines_of(hostile_kinds.__file__)}


def names() -> list[str]:
    lights = [f"{area}: {name}" for name in hostile_client.LIGHTS for area in ("light", "environment")]
    return [
        *(f"archive: {name}" for name in hostile_archives.ARCHIVES),
        *(f"picture: {name}" for name in hostile_pictures.CAPTURES),
        *(f"cameras: {name}" for name in hostile_poses.CAPTURES),
        *(f"bundle: {name}" for name in hostile_client.BUNDLES),
        *(f"packed bundle: {name}" for name in hostile_client.ARCHIVES),
        *lights,
        *(f"list of cameras: {name}" for name in hostile_client.CAMERAS),
    ]


@pytest.mark.parametrize("name", names())
def test_a_hostile_file_ends_in_a_clear_answer(kinds: dict[str, dict], name: str):
    assert kinds[name]["faults"] == []


def test_no_hostile_file_has_run_anything(kinds: dict[str, dict]):
    assert len(kinds) == len(names()) >= 80
    assert not ATTACKED.exists()


def test_files_changed_at_random_end_in_a_clear_answer():
    *faults, told = lines_of(mutations.__file__, "--count", str(MUTANTS), "--seed", str(SEED))
    assert faults == []
    assert told["faults"] == 0
    assert sum(told["outcomes"].values()) == MUTANTS


def test_a_reader_that_fails_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Break the readers on purpose: the runs would be worth nothing if they did not see it."""
    # The program imports from the folder of tests, which is on the path of pytest alone.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    program = (
        "import sys; from support import hostile_readers as r\n"
        "from lambent_capture.checks import check_child\nfrom pathlib import Path\n"
        "act = {'fails': lambda *_: 1 / 0, 'spawns': lambda *_: __import__('os').fork(),\n"
        "       'says nothing': lambda *_: None, 'hoards': lambda *_: bytearray(700 * 2**20)}\n"
        "for name, each in act.items():\n"
        "    check_child.check = each\n"
        "    print(name, list(r.faults_of(r.read_capture(name, Path(sys.argv[1])))) != [])\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines() == [
        f"{name} True" for name in ("fails", "spawns", "says nothing", "hoards")
    ], done.stderr
