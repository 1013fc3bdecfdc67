"""Serves the page that corrects masks, with the ball on its table and a second one that is none of it.

Prints the address, and when the person is done the corrections as one line of JSON.
"""

import argparse
import json
from collections.abc import Sequence

import numpy as np
from lambent_worker.editor.session import correct_masks
from lambent_worker.masks.corrections import Correction, record_of
from lambent_worker.masks.editing import Editing
from lambent_worker.masks.find import FindSettings, find_object
from support.ball_on_table import ball_on_table

BLOCK = np.array([0.95, 0.35, 0.3])
"""Middle of the second ball; its height is its radius."""


def main() -> None:
    """Serve it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--count", type=int, default=16)
    count = parser.parse_args().count
    capture = ball_on_table(count, block=BLOCK)
    found = find_object(capture.photographs, capture.points, FindSettings())
    assert not isinstance(found, str)
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


if __name__ == "__main__":
    main()
