"""Incoming light at surface elements, as tables over an octahedral square of directions."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from flashcache.evaluation.threads import on_all_cores
from flashcache.geometry.octahedron import octahedral_directions
from flashcache.physical.model import InverseModel
from flashcache.polish.elements import Elements

SIDE = 20
"""Cells along each side of the square."""
BELOW = -0.35
"""Cosine with the normal down to which directions are looked up: normals may tilt by twenty degrees."""
CHUNK_ELEMENTS = 256


@dataclass(frozen=True, slots=True, eq=False)
class IncomingTables:
    """What hides the environment from each element, and what it sends; directions row by row."""

    clear: Float[Tensor, "elements directions"]
    """Share of the environment that arrives."""
    near: Float[Tensor, "lights elements directions 3"]
    """Radiance of what hides it, premultiplied, linear Rec. 709."""


@torch.no_grad()
def incoming_tables(model: InverseModel, elements: Elements, num_lights: int) -> IncomingTables:
    """Return the fast cache's answers at `SIDE` x `SIDE` directions above each element."""
    directions = octahedral_directions(SIDE)
    count = len(elements)
    clear = torch.zeros(count, len(directions))
    near = torch.zeros(num_lights, count, len(directions), 3)
    origins = elements.positions + model.limits.origin_offset * elements.normal

    def fill(part: Int[Tensor, " some"]) -> None:
        asked = (elements.normal[part] @ directions.T) > BELOW
        row, column = asked.nonzero(as_tuple=True)
        for light in range(num_lights):
            index = torch.full_like(row, light)
            answer = model.fast(origins[part][row], directions[column], index)
            clear[part[row], column] = 1.0 - answer.opacity
            near[light, part[row], column] = answer.near_radiance

    on_all_cores(fill, torch.arange(count).split(CHUNK_ELEMENTS), origins.device)
    return IncomingTables(clear, near)
