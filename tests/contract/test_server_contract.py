"""The server's description of itself agrees with the rest of the repository."""

import json
import subprocess
import sys
from importlib import resources

import schema
from lambent_server.app import describe


def test_the_committed_description_is_current():
    assert json.loads((schema.ROOT / schema.OPENAPI).read_text()) == json.loads(json.dumps(describe()))


def test_generated_code_is_current(tmp_path):
    schema.lint()
    (tmp_path / "proto").mkdir()
    schema.generate_python(tmp_path / "proto")
    schema.generate_openapi(tmp_path / schema.OPENAPI)
    stale = [place for fresh, place in schema.generated(tmp_path) if fresh.read_bytes() != place.read_bytes()]
    assert stale == []


def test_the_server_offers_exactly_the_presets_of_the_method():
    from flashcache.presets import PRESETS

    text = resources.files("lambent_server").joinpath("presets.json").read_text()
    offered = json.loads(text)
    assert {each["name"] for each in offered["presets"]} == set(PRESETS)
    assert offered["default"] in PRESETS


def test_the_server_and_the_supervisor_import_neither_torch_nor_the_other_packages():
    code = (
        "import sys; import {module}; "
        "bad = {{'torch', 'numpy', 'numba', 'lambent_relight', {other!r}}} & set(sys.modules); "
        "sys.exit(str(bad) if bad else 0)"
    )
    for module, other in (
        ("lambent_server.serving, lambent_server.cli", "lambent_run"),
        ("lambent_run.job.supervisor", "flashcache.config"),
    ):
        subprocess.run([sys.executable, "-c", code.format(module=module, other=other)], check=True)


def test_every_operation_documents_its_problems():
    for path, operations in describe()["paths"].items():
        for method, operation in operations.items():
            for status, answer in operation["responses"].items():
                if status == "default" or (status.startswith(("4", "5")) and path != "/readyz"):
                    assert "application/problem+json" in answer["content"], (method, path, status)
