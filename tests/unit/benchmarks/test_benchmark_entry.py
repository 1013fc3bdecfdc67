"""One entry to all benchmarks: what is listed can be run, on a small scale as well."""

import json
import sys
from types import SimpleNamespace

from benchmarks import __main__ as entry


def test_every_benchmark_is_listed_with_a_sentence():
    found = entry.benchmarks()
    assert {"kernels", "quality", "footprint"} <= set(found)
    assert not {"reference_scores", "painted_scene"} & set(found)
    assert all(sentence.endswith((".", "?")) for sentence in found.values())


def measure(options):
    print("| rays | ms |")
    return {"ms": 2.0 * options.rays}


def test_what_was_printed_and_returned_is_kept_with_the_machine(tmp_path, monkeypatch):
    made_up = SimpleNamespace(
        __doc__="Time rays.",
        QUICK="--rays 1 --maps {maps}",
        add_options=lambda parser: [parser.add_argument(f"--{name}") for name in ("rays", "maps")],
        main=lambda options: measure(SimpleNamespace(rays=int(options.rays))),
    )
    monkeypatch.setitem(sys.modules, "benchmarks.made_up", made_up)
    for words in ([], ["--quick"]):
        entry.run("made_up", [*words, "--rays", "4", "-o", str(tmp_path)])
        record = json.loads((tmp_path / "result.json").read_text())
        assert (record["printed"], record["result"]) == ("| rays | ms |\n", {"ms": 8.0})
        assert record["machine"]["cores"] >= 1
    assert record["options"]["maps"].endswith("still_life/envmaps")


def test_a_name_that_is_no_benchmark_is_refused_with_the_list_of_those(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["benchmarks", "nothing"])
    monkeypatch.setattr(sys, "path", list(sys.path))
    assert entry.main() == 1
    told = capsys.readouterr()
    assert "there is no benchmark 'nothing'" in told.err
    assert "kernels" in told.out
