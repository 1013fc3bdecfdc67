"""Serves the page that corrects masks, with the ball on its table and a second one that is none of it.

Prints where the second ball is, as JSON (left, top, right, bottom by frame), then the address, and when the
person is done the corrections as one line of JSON.
"""

import argparse
import json
from collections.abc import Sequence

import numpy as np
from lambent_capture.editor.session import correct_masks
from lambent_capture.masks.corrections import Correction, record_of
from lambent_capture.masks.editing import Editing
from lambent_capture.masks.find import FindSettings, find_object
from support.ball_on_table import ball_on_table

SECOND = np.array([0.1, -0.85, 0.25])
"""Middle of the second ball; its height is its radius."""


def main() -> None:
    """Serve it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=12)
    count = parser.parse_args().count
    capture = ball_on_table(count, block=SECOND)
    found = find_object(capture.photographs, capture.points, FindSettings())
    assert not isinstance(found, str)
    print(json.dumps({name: box(mask) for name, mask in zip(found.names, capture.blocks, strict=True)}))
    kept: list[Sequence[Correction]] = [()]
    done = correct_masks(
        Editing(found, capture.photographs),
        (),
        kept.append,
        command="lambent train photographs -o run",
        tell=lambda text: print(text, flush=True),
        opens=False,
    )
    print(json.dumps({"done": done, **record_of(kept[-1])}), flush=True)


def box(mask: np.ndarray) -> list[int]:
    """Return left, top, right and bottom of what is in a mask, empty where nothing is."""
    if not mask.any():
        return []
    columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
    return [int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1]


if __name__ == "__main__":
    main()
