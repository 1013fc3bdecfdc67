"""Uploads are decoded by a process that can be taken over without harm, and whatever it says is doubted."""

import json
import signal
import struct
import sys
import time
from pathlib import Path

import pytest
from lambent_sandbox import sandbox
from lambent_server.api.problems import Problem
from lambent_server.core.settings import ServeError, Settings
from lambent_server.serving import require_sandbox
from lambent_server.storage import decoding
from lambent_server.storage.archives import unpack
from support import taken_over
from support.api import expect, expect_problem, opened
from support.archives import AnyRoom, make_zip

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have limits only"),
]

FORBIDDEN = {
    "the network": "socket.socket()",
    "a program": "os.execv('/bin/true', ['true'])",
    "a child": "os.posix_spawn('/bin/true', ['true'], {})",
    "a file elsewhere": "os.open('/tmp/lambent-attack', os.O_WRONLY | os.O_CREAT)",
    "removing": "os.unlink('/etc/hostname')",
}
SKY = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes(8)


def settings(act: str, **more: object) -> Settings:
    command = (sys.executable, taken_over.__file__, act)
    return Settings(decode_command=command, max_scene_bytes=100_000, max_scene_files=20, **more)


def refusal(tmp_path: Path, given: Settings, data: bytes = b"PK") -> Problem:
    """Return the problem of an archive."""
    archive = tmp_path / "archive"
    archive.write_bytes(data)
    (tmp_path / "out").mkdir()
    with pytest.raises(Problem) as caught:
        unpack(archive, tmp_path / "out", given, AnyRoom())
    return caught.value


@pytest.mark.parametrize("name", FORBIDDEN)
def test_a_reader_that_is_taken_over_is_stopped_and_the_answer_says_so(tmp_path: Path, name: str):
    problem = refusal(tmp_path, settings(FORBIDDEN[name]))
    assert (problem.status, problem.code) == (422, "decoder_stopped")
    assert "network" in problem.detail
    assert not Path("/tmp/lambent-attack").exists()


def test_a_reader_that_wants_all_memory_ends_in_a_refusal(tmp_path: Path):
    problem = refusal(tmp_path, settings("bytearray(8 * 2**30)"))
    assert (problem.status, problem.code) == (422, "archive_unsafe")
    assert "memory" in problem.detail


@pytest.mark.parametrize("act", ["while True: pass", "time.sleep(60)"])
def test_a_reader_that_does_not_end_is_ended(tmp_path: Path, act: str):
    began = time.monotonic()
    problem = refusal(tmp_path, settings(act, decode_cpu_s=1.0))
    assert (problem.status, problem.code) == (422, "archive_unsafe")
    assert time.monotonic() - began < 30.0


@pytest.mark.parametrize(
    "act", ["os.abort()", "ctypes.string_at(1)", "os._exit(0)", "os._exit(7)", "os.close(1); time.sleep(9)"]
)
def test_a_reader_that_dies_ends_in_a_refusal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, act: str):
    monkeypatch.setattr(decoding, "EXIT_S", 1.0)
    assert refusal(tmp_path, settings(act)).code == "decoder_stopped"


def say(*parts: bytes) -> str:
    """Return what makes the reader send these bytes as if it were done."""
    return f"os.write(1, {b''.join(parts)!r}); os._exit(0)"


def message(value: object) -> bytes:
    data = json.dumps(value).encode()
    return struct.pack(">I", len(data)) + data


LIES = {
    "no message": message([1]),
    "no JSON": struct.pack(">I", 3) + b"{{{",
    "a deep one": struct.pack(">I", 40000) + b"[" * 40000,
    "a long one": struct.pack(">I", 2**31) + b"x",
    "a problem of its own": message({"problem": "disk_full", "message": "x"}),
    "a problem with other types": message({"problem": "archive_unsafe", "subject": {}, "message": 3}),
    "an entry without a name": message({"size": 3}),
    "an entry of negative size": message({"name": "a.png", "size": -3}),
    "an entry outside": message({"name": "../a.png", "size": 0}) + bytes(4),
    "an entry larger than it says": message({"name": "a.png", "size": 1})
    + struct.pack(">I", 2)
    + b"ab"
    + bytes(4),
    "an entry shorter than it says": message({"name": "a.png", "size": 3})
    + struct.pack(">I", 2)
    + b"ab"
    + bytes(4),
    "an entry of too much": message({"name": "a.png", "size": 200_000}) + bytes(4),
    "one piece of too much": message({"name": "a.png", "size": 3}) + struct.pack(">I", 2**30),
    "the same entry twice": 2 * (message({"name": "a.png", "size": 0}) + bytes(4)),
    "an end that is none": message({"name": "a.png", "size": 3}) + b"\xff" * 4 + message({"done": True}),
    "many entries": b"".join(message({"name": f"{n}.png", "size": 0}) + bytes(4) for n in range(21)),
}


@pytest.mark.parametrize("name", LIES)
def test_nothing_that_the_reader_says_is_believed(tmp_path: Path, name: str):
    problem = refusal(tmp_path, settings(say(LIES[name])))
    assert problem.status == 422
    assert problem.code in ("decoder_stopped", "archive_unsafe", "archive_broken")


def test_an_environment_is_read_in_such_a_process_too(tmp_path: Path):
    with opened(tmp_path / "data", decode_command=settings("socket.socket()").decode_command) as api:
        answer = api.post("/v1/environments", params={"name": "sky"}, content=SKY)
        expect_problem(answer, 422, "decoder_stopped")
        scene = expect(api.post("/v1/scenes", json={"name": "x"}), 201)["id"]
        answer = api.put(f"/v1/scenes/{scene}/archive", content=make_zip({"a.png": b"x"}))
        expect_problem(answer, 422, "decoder_stopped")
        report = expect(api.get(f"/v1/scenes/{scene}/report"), 200)
        assert [each["code"] for each in report["findings"]] == ["decoder_stopped"]


@pytest.mark.parametrize(
    "head",
    [
        {"format": "png", "width": 1, "height": 1},
        {"format": ["exr"], "width": 1, "height": 1},
        {"format": "exr", "width": "1"},
        {},
        *(
            {"format": "exr", "width": width, "height": height}
            for width, height in ((0, 1), (1, 0), (-4, -4), (True, 1), (1, True), (1.0, 1), (10**5, 10**5))
        ),
    ],
)
def test_what_no_environment_has_is_refused(tmp_path: Path, head: dict):
    given = settings(say(message(head)))
    (tmp_path / "sky").write_bytes(SKY)
    with pytest.raises(Problem) as caught:
        decoding.environment_head(tmp_path / "sky", given)
    assert caught.value.code == "decoder_stopped"


def test_a_process_that_cannot_be_started_is_no_fault_of_the_upload(tmp_path: Path):
    with opened(tmp_path / "data", decode_command=("/nowhere/python",)) as api:
        scene = expect(api.post("/v1/scenes", json={"name": "x"}), 201)["id"]
        answer = api.put(f"/v1/scenes/{scene}/archive", content=make_zip({"a.png": b"x"}))
        assert expect_problem(answer, 503, "decoder_unavailable")["retryable"]
        assert expect(api.get(f"/v1/scenes/{scene}"), 200)["state"] == "open"


def test_this_system_has_every_layer():
    layers = decoding.probe(Settings())
    assert layers == sandbox.Layers(("limits", "privileges", "files", "calls"), {})


def test_a_layer_without_effect_is_found_by_trying(monkeypatch: pytest.MonkeyPatch):
    given = Settings()
    pretend = (
        "import sys, lambent_sandbox.filters as f, lambent_sandbox.landlock as l\n"
        "f.install = lambda rules: ''\nl.install = lambda paths: ''\n"
        "from lambent_server.storage import decoding_child\nsys.exit(decoding_child.main())"
    )
    given = Settings(decode_command=(sys.executable, "-c", pretend), sandbox="required")
    layers = decoding.probe(given)
    assert set(layers.missing) == {"files", "calls"}
    with pytest.raises(ServeError, match="sandbox_missing"):
        require_sandbox(given)
    assert require_sandbox(given.model_copy(update={"sandbox": "available"})).missing


def test_a_required_sandbox_that_is_missing_later_refuses_uploads_for_now(tmp_path: Path):
    without = (
        "import sys, lambent_sandbox.filters as f\nf.install = lambda rules: 'none'\n"
        "from lambent_server.storage import decoding_child\nsys.exit(decoding_child.main())"
    )
    problem = refusal(tmp_path, Settings(decode_command=(sys.executable, "-c", without), sandbox="required"))
    assert (problem.status, problem.code) == (503, "decoder_unavailable")


def test_the_end_by_a_signal_has_a_name():
    assert decoding._name(-signal.SIGSEGV) == "SIGSEGV"
    assert decoding._name(-63) == "signal 63"
    assert decoding._name(3) == "code 3"
