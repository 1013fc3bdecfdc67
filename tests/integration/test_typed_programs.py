"""Programs of users pass `mypy --strict`: one of forty lines, and the code of the documentation."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

PAGES = Path(__file__).parents[2] / "docs" / "howto"
PROGRAM = """
from pathlib import Path

from lambent import Client, Event, Job, LambentError, RefusedError, WaitTimeoutError
from lambent_relight import (
    MaterialEdit,
    Renderer,
    load_bundle,
    load_environment,
    turntable,
    write_picture_exr,
    write_png,
)


def show(update: Event | Job) -> None:
    if isinstance(update, Event) and update.type == "progress":
        print(update.progress.stage, update.progress.fraction)


def train(folder: Path, target: Path) -> int:
    with Client(data=Path("data")) as client:
        try:
            scene = client.push(folder)
            job: Job = client.submit(scene.id, preset="tiny", labels={"set": "cups"})
            for update in client.watch([job.id]):
                show(update)
            job = client.wait(job.id, timeout_s=60.0, progress=lambda job: print(job.state))
            client.fetch(job.id, target)
            sizes: list[int] = [artifact.size_bytes for artifact in client.artifacts(job.id)]
            return scene.size_bytes + sum(sizes)
        except RefusedError as error:
            print(error.code, [fault.message for fault in error.errors])
        except WaitTimeoutError as error:
            print(error.advice)
        except LambentError as error:
            print(error.code)
    return 0


def relight(bundle_folder: Path) -> None:
    renderer = Renderer(load_bundle(bundle_folder))
    light = load_environment("sky.exr")
    for camera in turntable(8, radius=4.0, width=64, height=64):
        picture = renderer.render(camera, light, spp=64, edit=MaterialEdit(roughness_scale=0.5))
        write_png(f"out/{camera.name}.png", picture.exposed(1.0))
        write_picture_exr(f"out/{camera.name}.exr", picture)
"""


def check(folder: Path, program: str) -> str:
    """Return what mypy says about a program outside of this repository."""
    (folder / "program.py").write_text(program)
    command = [sys.executable, "-m", "mypy", "--strict", "--no-incremental", "program.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def test_a_program_with_all_that_is_usual_has_types(tmp_path):
    assert check(tmp_path, PROGRAM) == "Success: no issues found in 1 source file\n"


def test_a_wrong_program_is_found_wrong(tmp_path):
    """Nothing is of type Any, with which every program would pass."""
    wrong = PROGRAM.replace("job.id, target", "job, target").replace(
        "renderer.render(camera", "renderer.render(1"
    )
    found = check(tmp_path, wrong)
    assert 'Argument 1 to "fetch" of "Client" has incompatible type "Job"; expected "str"' in found
    assert 'Argument 1 to "render" of "Renderer" has incompatible type "int"; expected "Camera"' in found


@pytest.mark.parametrize("page", ["use-the-sdk.md", "relight-from-python.md"])
def test_the_code_of_the_documentation_has_types(tmp_path, page):
    blocks = re.findall(r"```python\n(.*?)```", (PAGES / page).read_text(), re.DOTALL)
    assert len(blocks) == 4
    # The poses of the reader's own cameras.
    given = "import numpy as np\nposes = np.zeros((2, 4, 4))\n"
    assert check(tmp_path, given + "\n".join(blocks)) == "Success: no issues found in 1 source file\n"
