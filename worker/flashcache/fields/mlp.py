"""The fully connected networks of every field, and the scaling of the gradients that reach them."""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn


def linear(num_inputs: int, num_outputs: int) -> nn.Linear:
    """Return an affine layer with Kaiming-uniform weights (ReLU gain, fan-in) and zero biases."""
    layer = nn.Linear(num_inputs, num_outputs)
    bound = math.sqrt(6.0 / num_inputs)
    nn.init.uniform_(layer.weight, -bound, bound)
    nn.init.zeros_(layer.bias)
    return layer


def scale_gradient(values: Tensor, factor: float) -> Tensor:
    """Return `values` unchanged, with gradients multiplied by `factor` on the way back."""
    if factor == 1.0 or not values.requires_grad:
        return values
    if factor == 0.0:
        return values.detach()
    return torch.lerp(values.detach(), values, factor)


class Hidden(nn.Module):
    """Hidden layers of one width, without an output layer.

    With `skip_after` n the input is concatenated again behind the n-th layer.
    """

    def __init__(
        self,
        num_inputs: int,
        width: int,
        num_layers: int,
        *,
        skip_after: int | None = None,
        softplus_beta: float | None = None,
    ) -> None:
        super().__init__()
        sizes = [num_inputs] + [width] * num_layers
        layers = []
        for index in range(num_layers):
            skipped = num_inputs if skip_after is not None and index == skip_after else 0
            layers.append(linear(sizes[index] + skipped, width))
        self.layers = nn.ModuleList(layers)
        self.skip_after = skip_after
        self.softplus_beta = softplus_beta
        ends_with_skip = skip_after is not None and skip_after == num_layers
        self.num_outputs = (width if num_layers else num_inputs) + (num_inputs if ends_with_skip else 0)

    def forward(self, inputs: Float[Tensor, "*batch inputs"]) -> Float[Tensor, "*batch outputs"]:
        """Return the activations of the last hidden layer."""
        values = inputs
        for index, layer in enumerate(self.layers):
            if index == self.skip_after:
                values = torch.cat([values, inputs], dim=-1)
            values = layer(values)
            if self.softplus_beta is None:
                values = torch.relu(values)
            else:
                values = torch.nn.functional.softplus(values, beta=self.softplus_beta)
        if self.skip_after == len(self.layers):
            values = torch.cat([values, inputs], dim=-1)
        return values
