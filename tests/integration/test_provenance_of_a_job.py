"""A job's bundle comes with a statement that its server has signed, from the run to `lambent verify`."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from lambent import provenance
from lambent.client import Client
from support.live_server import LiveServer

pytestmark = [pytest.mark.slow]


def test_a_fetched_bundle_is_verified_without_its_server(tmp_path: Path):
    target, key = tmp_path / "sleep.relight", tmp_path / "key.json"
    with LiveServer(tmp_path / "data") as server:
        scene = server.scene("transforms_train.json", "images/r_0.png")
        job = server.submit(scene, num_steps=2, step_s=0.01)
        found = server.wait(job)
        key.write_bytes(server.client.get("/v1/provenance-key", headers={"authorization": ""}).content)
        with Client(server.url, api_key=server.key) as client:
            client.fetch(job, target)
        answer = server.client.get(f"/v1/bundles/{found['bundle_id']}/provenance")
        assert answer.json() == json.loads(provenance.beside(target).read_text())
        # Old readers refuse files that the manifest does not list, so that it must not be among them.
        assert "provenance" not in server.client.get(f"/v1/bundles/{found['bundle_id']}").text
        first_key = json.loads(key.read_text())["keyid"]
        server.end()
        server.start()
        assert server.client.get("/v1/provenance-key").json()["keyid"] == first_key
        assert server.client.delete(f"/v1/bundles/{found['bundle_id']}").status_code == 204
        assert server.client.get(f"/v1/bundles/{found['bundle_id']}/provenance").status_code == 404
    verified = provenance.verify(target, key=key)
    assert verified.trusted
    assert set(verified.inputs) == {"transforms_train.json", "images/r_0.png"}
    assert verified.invocation == f"{job}/1"
    assert verified.parameters["preset"] == "tiny"
    assert verified.parameters["params"]["num_steps"] == "2"
    assert verified.started_on < verified.finished_on
    command = [sys.executable, "-m", "lambent", "verify", str(target), "--key", str(key)]
    assert subprocess.run(command, check=True, env=os.environ, capture_output=True).returncode == 0
    with (target / "manifest.json").open("ab") as file:
        file.write(b" ")
    done = subprocess.run(command, check=False, env=os.environ, capture_output=True, text=True)
    assert (done.returncode, "manifest.json was changed" in done.stderr) == (1, True)
