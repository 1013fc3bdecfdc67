"""The sentences on inputs and outputs are the same in graphs and in the reference."""

import re
from pathlib import Path

import onnx
import pytest
from flashcache.export.onnx import WeightFile
from flashcache.export.relight_graph import relight_graph
from flashcache.export.signatures import SIGNATURES, documented

PAGE = Path(__file__).parents[4] / "docs" / "reference" / "graphs.md"


def test_the_reference_says_what_the_graphs_say():
    text = PAGE.read_text(encoding="utf-8")
    for kind, signature in SIGNATURES.items():
        section = re.search(rf"^## {kind}\n(.*?)^## ", text, re.DOTALL | re.MULTILINE)[1]
        assert signature.summary[1:] in section
        rows = re.findall(r"^\| (in|out): `(\w+)` \| \[.+\] \| (.+) \|$", section, re.MULTILINE)
        assert {name: meaning for way, name, meaning in rows if way == "in"} == signature.inputs
        assert {name: meaning for way, name, meaning in rows if way == "out"} == signature.outputs


def test_the_relight_graph_is_described_and_passes_the_checker():
    model = relight_graph(49, 16, WeightFile(), {})
    onnx.checker.check_model(model, full_check=True)
    signature = SIGNATURES["relight"]
    assert {item.name: item.doc_string for item in model.graph.input} == signature.inputs
    assert {item.name: item.doc_string for item in model.graph.output} == signature.outputs
    assert all(node.name for node in model.graph.node)


def test_an_input_without_a_sentence_is_noticed():
    with pytest.raises(KeyError, match="transfer_direct"):
        documented(relight_graph(9, 4, WeightFile(), {}), "material")
