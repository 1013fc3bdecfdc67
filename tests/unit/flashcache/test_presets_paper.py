"""Every number of the paper's presets is the one in tests/golden/paper_presets.txt, which names its source.

After a change on purpose, `python tests/unit/flashcache/test_presets_paper.py` writes the values anew, keeps
sources by path, and "?" stands where one has to be written by hand.
"""

import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Any

import pytest
import torch
from flashcache.config import Config, to_dict
from flashcache.fields.materials import ALPHA_MINIMUM
from flashcache.losses.fast_cache import fast_cache_loss
from flashcache.losses.photometric import CHARBONNIER_PADDING
from flashcache.losses.proposal import DISTORTION_CURVE
from flashcache.presets import preset
from flashcache.presets_paper import SCENES
from flashcache.training.optimiser import build_optimiser
from flashcache.volume.proposal_sampling import SECONDARY_CURVE

ROOT = Path(__file__).parents[3]
GOLDEN = ROOT / "tests" / "golden" / "paper_presets.txt"
PRESETS = ("paper_tensoir", "paper_openillumination", "paper_glossy")
SOURCE = r"supplement (2\.([1-9]|10)|table 1)|paper|code|data|no effect|ours"


def values(config: Config) -> dict[str, str]:
    """Return every setting as JSON by its path."""

    def leaves(node: Any, path: str) -> Iterator[tuple[str, str]]:
        items = enumerate(node) if isinstance(node, list) else node.items()
        for name, value in items:
            if isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
                yield from leaves(value, f"{path}{name}.")
            else:
                yield f"{path}{name}", json.dumps(value)

    found = dict(leaves(to_dict(config), ""))
    del found["preset"]
    return found


def numbers() -> dict[str, str]:
    """Return each setting's value, or its three values by preset, then what published scenes change."""
    by_preset = {name: values(preset(name)) for name in PRESETS}
    found = {}
    for path in by_preset[PRESETS[0]]:
        row = [by_preset[name][path] for name in PRESETS]
        found[path] = row[0] if len(set(row)) == 1 else " | ".join(row)
    for name, scenes in SCENES.items():
        for scene in scenes:
            changed = values(preset(f"{name}:{scene}")).items() - by_preset[name].items()
            found |= {f"{name}:{scene} {path}": value for path, value in sorted(changed)}
    return found | {f"constant {name}": json.dumps(value) for name, value in constants().items()}


def constants() -> dict[str, Any]:
    """Return numbers of the paper that no setting changes."""
    adam = build_optimiser([{"params": [torch.nn.Parameter(torch.zeros(1))]}]).defaults
    fast = inspect.signature(fast_cache_loss).parameters
    return {
        "Adam betas": adam["betas"],
        "Adam epsilon": adam["eps"],
        "Charbonnier padding": CHARBONNIER_PADDING,
        "weight of the fast cache's opacity": fast["opacity_weight"].default,
        "power and factor of secondary distances": astuple(SECONDARY_CURVE),
        "power and factor of distances in the distortion loss": astuple(DISTORTION_CURVE),
        "smallest GGX width": ALPHA_MINIMUM,
    }


def golden() -> dict[str, tuple[str, str]]:
    """Return value and source by path."""
    lines = GOLDEN.read_text(encoding="utf-8").splitlines()
    rows = (re.fullmatch(r"(.+?) = (.+?)  # (.+)", line) for line in lines if not line.startswith("#"))
    return {row[1]: (row[2], row[3]) for row in rows if row is not None}


def test_the_papers_presets_have_the_numbers_of_the_golden_file_and_no_others():
    kept = {path: value for path, (value, _) in golden().items()}
    assert numbers() == kept, f"if this change is on purpose: python {Path(__file__).relative_to(ROOT)}"


@pytest.mark.parametrize("source", sorted({source for _, source in golden().values()}))
def test_a_source_is_one_that_can_be_looked_up(source: str):
    assert re.fullmatch(rf"({SOURCE})((,| and|:| \().*)?", source)
    for number in re.findall(r"\d{4}", source):
        assert list((ROOT / "docs" / "decisions").glob(f"{number}-*.md"))


if __name__ == "__main__":
    head = [line for line in GOLDEN.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
    sources = {path: source for path, (_, source) in golden().items()}
    body = [f"{path} = {value}  # {sources.get(path, '?')}" for path, value in numbers().items()]
    GOLDEN.write_text("\n".join([*head, *body]) + "\n", encoding="utf-8")
