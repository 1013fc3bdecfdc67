"""Dependencies are pinned, needed, and under a licence that is allowed."""

import json

import dependencies
import pytest


@pytest.mark.parametrize(
    ("expression", "allowed"),
    [
        ("MIT", True),
        ("(Apache-2.0 AND BSD-3-Clause)", True),
        ("GPL-3.0-only OR MIT", True),
        ("GPL-3.0-only AND MIT", False),
        ("GPL-3.0-only", False),
        ("Apache-2.0 WITH LLVM-exception", True),
        ("SEE LICENSE IN file", False),
        ("MIT)(", False),
        ("", False),
        ("__import__('os')", False),
    ],
)
def test_an_expression_has_to_leave_a_choice_that_is_allowed(expression: str, allowed: bool):
    assert dependencies.is_allowed(expression) is allowed


def test_this_repository_has_no_problems():
    assert dependencies.check() == []


def test_pins_have_a_version_each_and_once(tmp_path, monkeypatch):
    monkeypatch.setattr(dependencies, "ROOT", tmp_path)
    for text in ("numpy>=2\n", "numpy\n", "numpy==2.0\nNumPy==2.1\n"):
        (tmp_path / "constraints.txt").write_text(text)
        with pytest.raises(ValueError, match=r"constraints.txt"):
            dependencies.pins()


def test_the_bill_of_materials_is_one_and_the_same_each_time():
    bill = dependencies.sbom()
    assert dependencies.validate(bill) == ""
    assert bill == dependencies.sbom()
    names = {each["name"] for each in bill["components"]}
    assert {"torch", "fastapi", "three", "onnxruntime-web"} <= names
    refs = {each["bom-ref"] for each in bill["components"]} | {bill["metadata"]["component"]["bom-ref"]}
    assert all({each["ref"], *each["dependsOn"]} <= refs for each in bill["dependencies"])
    assert all(each["licenses"] for each in bill["components"])


def test_a_bill_that_is_none_is_noticed():
    bill = json.loads(json.dumps(dependencies.sbom()))
    bill["components"][0]["type"] = "nonsense"
    assert dependencies.validate(bill) != ""


def test_an_audit_that_cannot_ask_says_so(capsys, monkeypatch):
    monkeypatch.setattr(dependencies, "LOCKS", ())
    assert dependencies.audit("/nowhere/python") == 3
    assert "NOT DONE" in capsys.readouterr().out
