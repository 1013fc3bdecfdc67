"""The wheel in empty environments: bare, and with each extra once, a command of each runs.

Packages come from pip's own index; where it cannot be reached, the tests are skipped with pip's last words,
which CI does not allow. torch alone is not fetched: the extras that need it see this environment's. The extra
`gpu` is left out, because all that it adds to `worker` is triton, 0.7 GB; CI installs it for the other tests.
"""

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterator
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
from lambent_relight import write_environment
from support.analytic_bundle import write_analytic_bundle
from support.analytic_scene import AnalyticScene, Sphere
from support.ball_photographs import write_ball_photographs
from support.captures import write_blender
from support.live_server import wait_until

ROOT = Path(__file__).parents[2]
CONSTRAINTS = ROOT / "constraints.txt"
CARD = "--grey-card=r_0.png:1,1,20,20"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
takes_minutes = pytest.mark.skipif(
    os.environ.get("CI") != "true" and "LAMBENT_TEST_EXTRAS" not in os.environ,
    reason="installs large packages, which takes minutes: make test-extras",
)


def without_ours(**changes: str) -> dict[str, str]:
    """Return the environment variables without those that name this repository or a server."""
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "LAMBENT_URL")}
    return kept | changes


def run(*command: object, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """Run a program outside the repository's own environment and return how it ended."""
    words = [str(word) for word in command]
    return subprocess.run(words, capture_output=True, text=True, env=env, cwd=ROOT / "tests", check=False)


def need_packages(done: subprocess.CompletedProcess[str]) -> None:
    """Skip the test where packages could not be had, but fail it in CI and where pip found a conflict."""
    if done.returncode == 0:
        return
    last = (done.stderr.strip() or done.stdout.strip())[-400:]
    if os.environ.get("CI") == "true" or "ResolutionImpossible" in done.stderr:
        pytest.fail(f"packages could not be installed: {last}")
    pytest.skip(f"packages cannot be had here: {last}")


class Installed:
    """An environment that holds the wheel, with the extras that were added, and nothing else."""

    def __init__(self, folder: Path, wheel: Path, extra: str = "", *, with_torch: bool = False) -> None:
        venv.create(folder, with_pip=False)
        self.environment = without_ours(LAMBENT_DATA=str(folder / "data"))
        self.bin = folder / ("Scripts" if os.name == "nt" else "bin")
        if with_torch:
            _link_torch(Path(self._purelib()))
        self._wheel = wheel
        self.add(extra)

    def add(self, extra: str) -> None:
        """Install the wheel with another extra."""
        target = f"lambent[{extra}] @ {self._wheel.as_uri()}" if extra else str(self._wheel)
        pip = (sys.executable, "-m", "pip", "--python", self.bin / "python", "--disable-pip-version-check")
        need_packages(run(*pip, "install", "-q", "-c", CONSTRAINTS, target, env=self.environment))

    def _purelib(self) -> str:
        return self.python("import sysconfig; print(sysconfig.get_path('purelib'))").stdout.strip()

    def python(self, code: str) -> subprocess.CompletedProcess[str]:
        """Run Python code."""
        return run(self.bin / "python", "-c", code, env=self.environment)

    def has(self, module: str) -> bool:
        """Return whether a module is installed."""
        code = f"import importlib.util, sys; sys.exit(importlib.util.find_spec({module!r}) is None)"
        return self.python(code).returncode == 0

    def lambent(self, *args: object, code: int = 0) -> str:
        """Run the command, which must exit with `code` and print no traceback; return all that it printed."""
        done = run(self.bin / "lambent", *args, env=self.environment)
        printed = done.stdout + done.stderr
        assert "Traceback" not in printed, printed
        assert done.returncode == code, printed
        return printed


def _link_torch(site_packages: Path) -> None:
    """Let an environment see this one's torch, so that pip takes it for installed."""
    torch = distribution("torch")
    if any("nvidia" in requirement for requirement in torch.requires or []):
        pytest.skip("torch is the build with CUDA here, whose packages are gigabytes")
    here = Path(sysconfig.get_path("purelib"))
    for name in {file.parts[0] for file in torch.files or ()} - {".."}:
        (site_packages / name).symlink_to(here / name)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Return the wheel, built as `make wheel` does: in an environment that has `build` and no torch."""
    folder = tmp_path_factory.mktemp("wheel")
    venv.create(folder / "tools", with_pip=True)
    python = folder / "tools" / "bin" / "python"
    env = without_ours(LAMBENT_WITHOUT_PAGES="1")
    need_packages(run(python, "-m", "pip", "install", "-q", "-c", CONSTRAINTS, "build", env=env))
    need_packages(run(python, "-m", "build", "-q", "--wheel", "--outdir", folder, ROOT, env=env))
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture
def install(wheel, tmp_path) -> Iterator:
    """Return a function that installs the wheel with an extra; the environment is removed at the end."""
    folder = tmp_path / "environment"
    yield lambda extra="", **options: Installed(folder, wheel, extra, **options)
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def light(tmp_path) -> Path:
    """Return an environment map."""
    path = tmp_path / "sky.exr"
    write_environment(path, np.ones((4, 8, 3), np.float32))
    return path


@pytest.fixture
def bundle(tmp_path) -> Path:
    """Return a small bundle."""
    return write_analytic_bundle(tmp_path / "bundle", AnalyticScene([Sphere((0.0, 0.0, 0.0), 1.0)]))


def test_the_bare_wheel_is_a_client_and_says_what_else_to_install(install):
    bare = install()
    assert bare.lambent("--version").startswith("lambent ")
    assert "numpy" in bare.lambent("doctor")
    assert "server.not_running" in bare.lambent("jobs", code=3)
    assert bare.python("import lambent; [getattr(lambent, name) for name in lambent.__all__]").returncode == 0
    wanted = {
        "client": (
            ("relight", "b", "--env", "m", "-o", "o"),
            ("turntable", "b", "--env", "m", "-o", "o.webp"),
            ("export", "b", "-o", "o", "--glb"),
        ),
        "capture": (("check", "d"), ("poses", "d", "-o", "s"), ("masks", "d", "-o", "s")),
        "server": (("serve",), ("keys", "list")),
        "worker": (("train", "d", "-o", "r"), ("evaluate", "r", "d", "-o", "e")),
        "server,worker": (("demo",),),
    }
    for extra, commands in wanted.items():
        for command in commands:
            assert f"pip install 'lambent[{extra}]'" in bare.lambent(*command, code=2), command
    imported = bare.python("from lambent_relight import Renderer").stderr.splitlines()[-1]
    assert "pip install 'lambent[client]'" in imported


@takes_minutes
def test_the_extra_client_relights_a_bundle_and_film_and_viewer_add_to_it(install, bundle, light, tmp_path):
    client = install("client")
    assert not client.has("torch")
    out = tmp_path / "pictures"
    client.lambent("relight", bundle, "--env", light, "--turntable", 1, "--size", 16, "--spp", 4, "-o", out)
    assert len(list(out.rglob("*.png"))) == 1
    film = tmp_path / "turn.mp4"
    small = ("--frames", 2, "--size", 16, "--spp", 4, "--quality", "refined")
    assert "lambent[film]" in client.lambent("turntable", bundle, "--env", light, "-o", film, code=2)
    client.add("film")
    client.lambent("turntable", bundle, "--env", light, *small, "-o", film)
    assert film.stat().st_size > 0
    assert "lambent[viewer]" in client.lambent("view", bundle, "--desktop", code=2)
    client.add("viewer")
    assert client.python("import lambent.desktop.window, pyvista").returncode == 0


def test_the_extra_capture_does_a_photographers_work_without_torch(install, tmp_path):
    capture = install("capture")
    assert not any(map(capture.has, ("torch", "onnxruntime", "numba")))
    write_ball_photographs(tmp_path / "ball")
    assert "can be used" in capture.lambent("check", tmp_path / "ball")
    capture.lambent("masks", tmp_path / "ball", "-o", tmp_path / "cut")
    assert len(list((tmp_path / "cut" / "masks").glob("*.png"))) == 12
    assert "lambent[worker]" in capture.lambent("check", tmp_path / "ball", CARD, code=2)
    assert "lambent[client]" in capture.lambent("relight", "b", "--env", "m", "-o", "o", code=2)
    # Photographs without cameras: too few to be placed, which only the search itself can find out.
    photographs = tmp_path / "photographs"
    shutil.copytree(tmp_path / "ball" / "train", photographs)
    assert "scene.poses" in capture.lambent("poses", photographs, "-o", tmp_path / "scene", code=4)
    assert "scene.poses" in capture.lambent("masks", photographs, "-o", tmp_path / "run", code=4)
    assert json.loads((tmp_path / "run" / "run.json").read_text())["config"] is None


@takes_minutes
def test_the_extras_raw_and_rembg_add_to_capture_without_torch(install, tmp_path):
    capture = install("raw")
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    (photographs / "a.dng").write_bytes(b"no raw file")
    assert "scene.raw_not_installed" not in capture.lambent("check", photographs, code=4)
    write_ball_photographs(tmp_path / "ball")
    network = tmp_path / "u2net.onnx"
    network.write_bytes(b"no network")
    masks = ("masks", tmp_path / "ball", "--segmenter", f"rembg={network}", "-o", tmp_path / "cut")
    assert "lambent[rembg]" in capture.lambent(*masks, code=2)
    capture.add("rembg")
    assert "is not a network that rembg can run" in capture.lambent(*masks, code=2)
    assert not capture.has("torch")


def test_the_extra_server_serves_the_bare_client_inside(install):
    server = install("server")
    assert not server.has("torch")
    serving = subprocess.Popen(
        [server.bin / "lambent", "serve", "--port", "0"],
        env=server.environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        wait_until(lambda: run(server.bin / "lambent", "jobs", env=server.environment).returncode == 0)
        server.lambent("keys", "create", "ours")
        assert "ours" in server.lambent("keys", "list")
    finally:
        serving.terminate()
        assert serving.wait(timeout=60) == 0


@takes_minutes
def test_the_extra_worker_plans_a_training_and_usd_and_draco_add_to_it(install, tmp_path):
    worker = install("worker", with_torch=True)
    scene = write_blender(tmp_path / "scene")
    plan = worker.lambent("train", scene, "--preset", "tiny", "--dry-run", "-o", tmp_path / "run")
    assert "rays" in plan
    assert "can be used" in worker.lambent("check", scene)
    worker.add("usd")
    assert worker.python("import lambent_asset.bundle.usd; from pxr import Usd, UsdUtils").returncode == 0
    worker.add("draco")
    assert worker.python("from lambent_relight.asset import draco; draco._library('a test')").returncode == 0
