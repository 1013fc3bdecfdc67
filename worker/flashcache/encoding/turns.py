"""The turns of a light that moves relative to the object, and their encoding for networks.

A turn is the rotation from world directions at one photograph to the frame in which the light is fixed;
light number 0 is the turn of the reference, the identity.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

POWERS = (1, 2, 4)
"""Powers of a rotation that describe it to networks."""

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


class LightTurns(nn.Module):
    """The turns of one light by light index, shared by all parts of a model that depend on them.

    They are known, not learned, and belong to the photographs: checkpoints do not contain them.
    """

    rotations: Tensor
    codes: Tensor
    out_features = 9 * len(POWERS)
    """Numbers that describe a turn."""

    def __init__(self, turns: Sequence[Sequence[float]]) -> None:
        """`turns` are row-major rotations, the identity first."""
        super().__init__()
        rotations = torch.tensor(turns, dtype=torch.float32).reshape(-1, 3, 3)
        assert torch.equal(rotations[0], torch.eye(3)), "light number 0 is the reference"
        self.register_buffer("rotations", rotations, persistent=False)
        self.register_buffer("codes", describe(rotations), persistent=False)

    def to_light(
        self, vectors: Float[Tensor, "rows 3"], light_index: Int[Tensor, " rows"]
    ) -> Float[Tensor, "rows 3"]:
        """Return world vectors in the frame of the light at each row's turn."""
        return (self.rotations[light_index] @ vectors[..., None])[..., 0]

    def to_world(
        self, vectors: Float[Tensor, "rows lobes 3"], light_index: Int[Tensor, " rows"]
    ) -> Float[Tensor, "rows lobes 3"]:
        """Return several vectors per row, given in the frame of the light, in the world."""
        return vectors @ self.rotations[light_index]

    def code(self, light_index: Int[Tensor, " rows"]) -> Float[Tensor, "rows code"]:
        """Return the numbers that describe each row's turn."""
        return self.codes[light_index]

    def index_of(self, turn: Float[Tensor, "3 3"]) -> int:
        """Return the light index of a turn, which is added where it is new."""
        turn = turn.to(self.rotations)
        same = (self.rotations - turn).abs().amax(dim=(1, 2)) < 1e-6
        if bool(same.any()):
            return int(same.nonzero()[0, 0])
        self.rotations = torch.cat([self.rotations, turn[None]])
        self.codes = torch.cat([self.codes, describe(turn[None])])
        return len(self.rotations) - 1


def describe(rotations: Float[Tensor, "turns 3 3"]) -> Float[Tensor, "turns code"]:
    """Return the entries of R, R^2 and R^4.

    For turns by an angle t about any one axis these are linear in the cosines and sines of t, 2t and 4t: a
    Fourier series on the circle that has no seam, and needs no axis to be known for other rotations.
    """
    powers = [torch.linalg.matrix_power(rotations, power) for power in POWERS]
    return torch.cat([power.reshape(-1, 9) for power in powers], dim=-1)
