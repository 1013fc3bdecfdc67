"""Which backend answers an encoder call."""

from jaxtyping import Float
from torch import Tensor

from flashcache.kernels import reference
from flashcache.kernels.layout import GridLayout


def encode(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> Float[Tensor, "points outputs"]:
    """Return the interpolated features of `z`, levels coarse to fine."""
    return reference.encode(z, table, layout)


def encode_with_jacobian(
    z: Float[Tensor, "points 3"], table: Float[Tensor, "rows features"], layout: GridLayout
) -> tuple[Float[Tensor, "points outputs"], Float[Tensor, "points outputs 3"]]:
    """Return the features of `z` and their derivative by `z`."""
    return reference.encode_with_jacobian(z, table, layout)
