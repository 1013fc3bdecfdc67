"""The readers that hostile files are given to: uploads, the check of a capture, and the client's own."""

import io
import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from lambent_sandbox.sandbox import Layers
from lambent_server.api.problems import Problem
from lambent_server.core.settings import Settings
from lambent_server.scenes import rows as scene_rows
from lambent_server.storage import archives, decoding, decoding_child
from lambent_server.storage.decoding import Decoder
from lambent_server.storage.paths import path_problem
from support.archives import AnyRoom
from support.hostile_runs import MIB, OUT_OF_MEMORY, Verdict, captured, judge, lines_of, run

ROOT = Path(__file__).parents[2]
SETTINGS = Settings(max_scene_bytes=2_000_000, max_scene_files=60, max_environment_pixels=4096 * 2048)
MAX_GROWTH_KIB = 512 * 1024
UPLOAD_CODES = {
    *("archive_unsafe", "archive_broken", "archive_nested", "archive_empty", "environment_invalid"),
    *("path_unsafe", "scene_too_large"),
}


@cache
def documented() -> frozenset[str]:
    """Return the codes of docs/reference/findings-codes.md."""
    text = (ROOT / "docs" / "reference" / "findings-codes.md").read_text(encoding="utf-8")
    return frozenset(re.findall(r"`([a-z_]+\.[a-z_]+)`", text))


class Recorded(Decoder):
    """A decoder whose process has ended already."""

    def __init__(self, task: str, output: bytes, code: int) -> None:
        self._refusal = decoding._REFUSALS[task]
        self.timed_out = False
        self._stream = io.BytesIO(output)
        self._code = code

    def close(self) -> None:
        """Do nothing."""

    def ended(self) -> int:
        """Return the exit code."""
        return self._code

    def exactly(self, size: int) -> bytes:
        """Return the next bytes, as the real one does."""
        data = self._stream.read(size)
        if len(data) < size:
            raise self._how_it_ended()
        return data


def _decode(task: str, data: bytes, **order: Any) -> Any:
    def act(out: IO[bytes]) -> None:
        decoding_child.do({"task": task, **order}, Layers((), {}), io.BytesIO(data), out)

    return run(act, SETTINGS.decode_memory_bytes, None)


def read_archive(name: str, data: bytes, *, check: bool = True) -> Verdict:
    """Upload an archive, commit what it holds, and check that as a capture."""
    budget = int(min(SETTINGS.max_scene_bytes, SETTINGS.max_archive_ratio * max(len(data), 1)))
    done = _decode("archive", data, budget=budget, max_files=SETTINGS.max_scene_files)
    found = judge(name, done)
    decoder = Recorded("archive", done.output, -9 if done.code == OUT_OF_MEMORY else done.code)
    with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
        kept = Path(folder) / "kept"
        kept.mkdir()
        try:
            members, _ = archives._keep(decoding._entries(decoder), kept, budget, SETTINGS, AnyRoom())
            files = [scene_rows.SceneFile(each.path, each.sha256, each.size_bytes) for each in members]
            scene_rows.check_files(files, SETTINGS)
        except Problem as problem:
            found.codes.append(problem.code)
            if problem.code not in UPLOAD_CODES or not problem.detail:
                found.faults.append(f"refused as {problem.code}: {problem.detail}")
            return found
        scene = Path(folder) / "scene"
        scene.mkdir()
        for each in members:
            if (
                path_problem(each.path)
                or each.file.parent != kept
                or each.file.stat().st_size != each.size_bytes
            ):
                found.faults.append(f"accepted {each.path!r}")
                return found
            target = scene / each.path
            target.parent.mkdir(parents=True, exist_ok=True)
            each.file.rename(target)
        if sum(each.size_bytes for each in members) > budget:
            found.faults.append("accepted more than is allowed")
        if not check or not members:
            found.refused = False
            return found
        checked = read_capture(name, scene)
    checked.faults += found.faults
    checked.grown_kib = max(found.grown_kib, checked.grown_kib)
    return checked


def read_environment(name: str, data: bytes) -> Verdict:
    """Upload an environment; what is accepted is read by the client's library, as a job would."""
    done = _decode("environment", data[: 64 * 1024], max_pixels=SETTINGS.max_environment_pixels)
    found = judge(name, done)
    try:
        told = Recorded("environment", done.output, done.code).message()
    except Problem as problem:
        found.codes.append(problem.code)
        if problem.code not in UPLOAD_CODES:
            found.faults.append(f"refused as {problem.code}: {problem.detail}")
        return found
    if not 0 < told["width"] * told["height"] <= SETTINGS.max_environment_pixels:
        found.faults.append(f"accepted {told}")
    with tempfile.TemporaryDirectory(prefix="hostile-") as folder:
        path = Path(folder) / f"sky.{told['format']}"
        path.write_bytes(data)
        return read_light(name, path)


def read_capture(name: str, folder: Path) -> Verdict:
    """Check a capture as a worker does."""
    from lambent_capture.checks import check_child

    done = run(captured(lambda: check_child.check(folder, None, None, None, {})), 1024 * MIB, [folder])
    found = judge(name, done)
    reports = lines_of(done.output, "report")
    if not reports:
        if not found.faults and "stopped" not in found.codes:
            found.faults.append("no report")
        if "stopped" in found.codes and not any(lines_of(done.output, "reading")):
            found.codes.append("without a file")
        return found
    found.refused = not reports[0].get("usable", False)
    for each in reports[0].get("findings", []):
        found.codes.append(each["code"])
        found.texts.append((each["code"], f"{each.get('subject', '')} {each.get('message', '')}"))
        if each["code"] not in documented():
            found.faults.append(f"{each['code']} is not documented")
        if not each.get("message"):
            found.faults.append(f"{each['code']} says nothing")
    errors = [each for each in reports[0].get("findings", []) if each["severity"] == "SEVERITY_ERROR"]
    if found.refused and not errors:
        found.faults.append("refused without a finding")
    return found


def _client(name: str, act: Any) -> Verdict:
    """Return what the client's library makes of a file: an error of its own, or nothing to object."""
    from lambent_core.errors import RelightError

    def guarded() -> None:
        try:
            act()
            print("accepted 1")
        except RelightError as error:
            print("refused", json.dumps([error.code, error.message, error.advice]))

    done = run(captured(guarded), 2048 * MIB, None, sandboxed=False)
    found = judge(name, done)
    for code, message, advice in lines_of(done.output, "refused"):
        found.codes.append(code)
        if not message or not advice:
            found.faults.append(f"{code} says nothing")
    found.refused = not lines_of(done.output, "accepted")
    return found


def read_light(name: str, path: Path) -> Verdict:
    """Read an environment map with the client's library."""
    from lambent_relight.environment.maps import load_environment

    return _client(name, lambda: load_environment(path))


def read_bundle(name: str, path: Path, *, deep: bool = True) -> Verdict:
    """Open a bundle with the client's library, and read all of it; `deep` evaluates networks too."""
    from lambent_relight.baked.scene import load_baked_scene
    from lambent_relight.bundle.bundle import load_bundle
    from lambent_relight.bundle.graphs import OnnxCaches

    def act() -> None:
        bundle = load_bundle(path)
        for graph in bundle.manifest.graphs:
            bundle.graph(graph.path)
        assert isinstance(bundle.weights, bytes)
        bundle.cameras()
        for light in bundle.manifest.train_lights:
            bundle.trained_environment(light)
        bundle.uncertainty()
        load_baked_scene(bundle)
        if deep:
            caches = OnnxCaches(bundle, num_threads=1)
            point = np.zeros((1, 3), dtype=np.float32)
            caches.material(point)
            caches.gbuffer(point, point + np.float32(0.577))

    return _client(name, act)


def read_cameras(name: str, data: bytes) -> Verdict:
    """Read a list of cameras with the client's library."""
    from lambent_relight.cameras import parse_cameras

    return _client(name, lambda: parse_cameras(data, source="cameras.json"))


def warm_up() -> None:
    """Load what the readers need, so that every copy has it."""
    import lambent_capture.checks.check_child
    import lambent_capture.checks.photograph_check
    import lambent_capture.checks.review
    import lambent_capture.loading.inspect
    import lambent_relight.asset.glb
    import lambent_relight.baked.scene
    import lambent_relight.bundle.bundle
    import lambent_relight.environment.maps
    import OpenEXR
    from PIL import Image

    Image.init()
    decoding_child.load()
    with suppress(ImportError):
        import pillow_heif

        pillow_heif.register_heif_opener()
    from support.hostile_client import GOLDEN

    lambent_relight.baked.scene.load_baked_scene(lambent_relight.bundle.bundle.load_bundle(GOLDEN))
    assert all((lambent_relight, lambent_capture, OpenEXR))


def faults_of(found: Verdict) -> Iterator[str]:
    """Yield what must not have happened."""
    yield from found.faults
    if found.grown_kib > MAX_GROWTH_KIB:
        yield f"took {found.grown_kib // 1024} MiB"
