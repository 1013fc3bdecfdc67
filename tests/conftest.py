"""Common setup of all tests: thread settings, import paths, checked annotations, devices, explicit skips."""

import contextlib
import importlib.util
import os
import re
import signal
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

# Before torch is imported: a waiting OpenMP thread must sleep, or a busy neighbour slows a step many times.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import jaxtyping
import psutil
import pytest

TESTS = Path(__file__).parent
ROOT = TESTS.parent
sys.path[:0] = [str(TESTS), str(ROOT), *(str(ROOT / name) for name in ("scripts", "examples"))]

# Inherited by every process that the tests start, and by the runs of their servers.
SESSION = uuid.uuid4().hex
os.environ |= {"LAMBENT_TEST_SESSION": SESSION, "LAMBENT_RUN_ENVIRONMENT": "LAMBENT_TEST_SESSION"}

# A shell that starts the tests in the background has them ignore Ctrl-C, and all that they start with them.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

IN_CI = os.environ.get("CI") == "true"
MUST_RUN_IN_CI = ("browser", "services", "long")
_COMPILED = re.compile(r"^\s*(import|from) (numba|triton|lambent_compute\.compiling)\b", re.MULTILINE)


def annotated_modules(package: str) -> list[str]:
    """Return the dotted names of the modules of `package` whose annotations can be checked.

    Modules that hand functions to a compiler (numba, triton) are left out: it would compile the check.
    """
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        return []
    folder = Path(next(iter(spec.submodule_search_locations)))
    return [
        ".".join((package, *path.relative_to(folder).with_suffix("").parts))
        for path in sorted(folder.rglob("*.py"))
        if path.name != "__init__.py" and not _COMPILED.search(path.read_text(encoding="utf-8"))
    ]


# Shapes and types of the method's functions are documentation everywhere and are enforced here only.
jaxtyping.install_import_hook(annotated_modules("flashcache"), "beartype.beartype")


def _has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()


@pytest.fixture(params=["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def device(request: pytest.FixtureRequest):
    """Return each torch device that tests run on: the CPU, and CUDA where there is one."""
    import torch

    return torch.device(request.param)


def processes_of_session() -> dict[psutil.Process, str]:
    """Return the running processes that the tests have started, with their commands."""
    found = {}
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):
            ours = process.environ().get("LAMBENT_TEST_SESSION") == SESSION and process.pid != os.getpid()
            # The standard library's helper ends with this process.
            command = " ".join(process.cmdline())
            if ours and "multiprocessing.resource_tracker" not in command:
                found[process] = command
    return found


@pytest.fixture(scope="session", autouse=True)
def nothing_is_left_behind() -> Iterator[None]:
    """Fail if processes are still running ten seconds after the tests that started them."""
    yield
    deadline = time.monotonic() + 10.0
    while (left := processes_of_session()) and time.monotonic() < deadline:
        time.sleep(0.1)
    for process in left:
        with contextlib.suppress(psutil.Error):
            process.kill()
    assert not left, f"processes are left behind: {left}"


def pytest_configure() -> None:
    """Refuse a run in CI that would leave out the tests of the GPU's kernels."""
    missing = sys.platform == "linux" and importlib.util.find_spec("triton") is None
    if IN_CI and missing:
        raise pytest.UsageError("CI tests the GPU's kernels: make setup EXTRAS=dev,gpu")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("long") and not IN_CI and "LAMBENT_TEST_ALL" not in os.environ:
        pytest.skip("is long: make test-all")
    if item.get_closest_marker("gpu") and not _has_cuda():
        pytest.skip("needs a CUDA device")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo):
    """Fail a browser or services test that was skipped in CI, where all they need is installed."""
    report = yield
    if not (report.skipped and IN_CI) or hasattr(report, "wasxfail"):
        return report
    markers = [name for name in MUST_RUN_IN_CI if item.get_closest_marker(name)]
    if markers:
        report.outcome = "failed"
        report.longrepr = (
            f"a test marked {markers[0]} was skipped, which CI does not allow: {report.longrepr}"
        )
    return report


def pytest_collection_modifyitems(items):
    """Run the files that take minutes first, so that no worker is left with one at the end."""
    order = ("e2e", "conformance", "integration")
    items.sort(
        key=lambda item: next((n for n, part in enumerate(order) if part in item.path.parts), len(order))
    )
