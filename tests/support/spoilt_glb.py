"""GLB files of a stranger: damaged on purpose."""

import copy
from typing import Any

import numpy as np
from lambent_relight.baked.mesh import glb_chunks, glb_of

_VALUES = ("a", None, [], {}, ["a"], -1, 0, 7, 1.5, 1 << 70, 1e300, True)


def with_document(data: bytes, document: Any) -> bytes:
    """Return the GLB with another JSON chunk."""
    _, payload = glb_chunks(data)
    return glb_of(document, payload)


def spoilt_glb(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the GLB with another value, of any type, at one place of its JSON chunk."""
    document = copy.deepcopy(glb_chunks(data)[0])
    places = [(document, key) for key in document]
    for inside, key in places:
        value = inside[key]
        if isinstance(value, dict | list):
            places += [(value, each) for each in (value if isinstance(value, dict) else range(len(value)))]
    inside, key = places[rng.integers(len(places))]
    inside[key] = copy.deepcopy(_VALUES[rng.integers(len(_VALUES))])
    return with_document(data, document)
