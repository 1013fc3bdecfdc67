"""Jobs of the kind `bake`: what an order must name, and what its run gets."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from lambent_core.errors import UsageError
from lambent_proto.v1 import worker_pb2
from lambent_run.job.bake import request_of, run_bake
from lambent_run.job.order import Order
from support.api import expect, expect_problem
from support.recording_reporter import RecordingReporter
from support.runs import Stage, staged
from support.server_rows import add_bundle

FILES = {"manifest.json": b"{}", "models/weights.bin": b"weights"}
# The smallest Radiance map: 2 x 1 pixels.
MAP = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + bytes([128, 128, 128, 129] * 2)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder = tmp_path_factory.mktemp("bakes")
    with staged(folder) as stage:
        add_bundle(stage.api, folder, FILES, scene_id=stage.api.scene())
        yield stage


@pytest.fixture(scope="module")
def sky(stage: Stage) -> str:
    answer = stage.api.post("/v1/environments", params={"name": "sky.hdr"}, content=MAP)
    return str(expect(answer, 201)["id"])


def order(stage: Stage, **params: str) -> Any:
    """Return the answer to an order of a bake of the one bundle there is."""
    bundle = expect(stage.api.get("/v1/bundles"), 200)["items"][0]
    params = {"bundle": bundle["id"], **params}
    return stage.api.post("/v1/jobs", json={"scene_id": bundle["scene_id"], "kind": "bake", "params": params})


def test_a_run_gets_the_bundle_and_the_environment(stage: Stage, sky: str):
    job = expect(order(stage, environment=sky, rotate_deg="30"), 202)
    assert (job["kind"], job["gpus"]) == ("bake", 0)
    stage.controller.turn()
    given = stage.call("Start", job["id"], code_version="1")
    assert {file.path for file in given.files} == {
        "bundle/manifest.json",
        "bundle/models/weights.bin",
        "environment.hdr",
    }
    assert (given.kind, given.check_scene, given.scene_name) == ("bake", False, "inputs")
    assert given.params["rotate_deg"] == "30"


@pytest.mark.parametrize(
    ("params", "code", "pointer"),
    [
        ({"environment": ""}, "bake_input_missing", "#/params/environment"),
        ({"environment": "env_x"}, "environment_not_found", "#/params/environment"),
        ({"environment": "sky", "bundle": "bundle_none"}, "bundle_not_found", "#/params/bundle"),
        ({"environment": "sky", "turn": "1"}, "bake_setting_unknown", "#/params/turn"),
    ],
)
def test_an_order_that_names_nothing_usable_is_pointed_at(
    stage: Stage, sky: str, params: dict[str, str], code: str, pointer: str
):
    if params["environment"] == "sky":
        params = params | {"environment": sky}
    problem = expect_problem(order(stage, **params), 422, code)
    assert problem["errors"][0]["pointer"] == pointer


def test_an_order_means_a_request(tmp_path: Path):
    params = {"rotate_deg": "-90", "albedo_ratio": "1,2,0.5", "steps": "7", "environment": "env_1"}
    request = request_of(
        worker_pb2.StartResponse(params=params, seed=5, device="cpu"), tmp_path / "environment.hdr"
    )
    assert (request.name, request.rotate_deg, request.albedo_ratio) == ("env_1", -90.0, (1.0, 2.0, 0.5))
    assert (request.config.num_steps, request.seed, request.device) == (7, 5, "cpu")


@pytest.mark.parametrize("params", [{"rotate_deg": "east"}, {"albedo_ratio": "1,2"}, {"steps": "nan"}])
def test_settings_that_are_no_numbers_are_refused(tmp_path: Path, params: dict[str, str]):
    from flashcache.errors import ConfigError

    with pytest.raises(ConfigError, match=next(iter(params))):
        request_of(worker_pb2.StartResponse(params=params), tmp_path / "environment.hdr")


def test_inputs_that_are_gone_end_the_job_with_a_reason(tmp_path: Path):
    with pytest.raises(UsageError, match=r"bake\.input_missing"):
        run_bake(
            Order(
                start=worker_pb2.StartResponse(kind="bake"),
                scene_dir=tmp_path,
                run_dir=tmp_path / "run",
                reporter=RecordingReporter(),
            )
        )
