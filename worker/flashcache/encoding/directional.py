"""Encodings of directions and positions by fixed functions: frequencies and integrated harmonics."""

import math

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial import Chebyshev, Legendre
from torch import Tensor, nn


def positional_encoding(
    values: Float[Tensor, "*batch channels"], num_frequencies: int
) -> Float[Tensor, "*batch encoded"]:
    """Return [v, sin(v), sin(2 v), .. , cos(v), cos(2 v), ..]: channels (1 + 2 num_frequencies) numbers.

    Frequencies double from 1; each block keeps the order of the channels. Nothing is multiplied by pi.
    Source: NeRF Eq. 4, with the identity kept.
    """
    if num_frequencies == 0:
        return values
    scaled = torch.cat([values * 2.0**octave for octave in range(num_frequencies)], dim=-1)
    return torch.cat([values, scaled.sin(), scaled.cos()], dim=-1)


class IntegratedDirectionalEncoding(nn.Module):
    """Spherical harmonics of degrees 1, 2, 4, .. averaged over a von Mises-Fisher lobe (Ref-NeRF Eq. 6 to 8).

    Degree l gives real and imaginary parts of the orders 0 to l; with `num_degrees` 5 these are 72 numbers.
    """

    def __init__(self, num_degrees: int) -> None:
        super().__init__()
        degrees = [2**i for i in range(num_degrees)]
        terms = [(degree, order) for degree in degrees for order in range(degree + 1)]
        self.max_degree = degrees[-1]
        self.out_features = 2 * len(terms)
        # In the Chebyshev basis the sums hardly cancel; in powers of z, degree 16 would lose five digits.
        matrix = np.zeros((self.max_degree + 1, len(terms)))
        for column, (degree, order) in enumerate(terms):
            polynomial = Legendre.basis(degree).convert(kind=Chebyshev).deriv(order).coef
            matrix[: len(polynomial), column] = _normalisation(degree, order) * polynomial
        self.register_buffer("polynomials", torch.tensor(matrix, dtype=torch.float32), persistent=False)
        self.register_buffer("orders", torch.tensor([order for _, order in terms]), persistent=False)
        rates = torch.tensor([degree * (degree + 1) / 2 for degree, _ in terms])
        self.register_buffer("rates", rates, persistent=False)

    def forward(
        self, directions: Float[Tensor, "*batch 3"], inverse_concentration: Float[Tensor, "*batch 1"]
    ) -> Float[Tensor, "*batch encoded"]:
        """Return all real parts, then all imaginary parts, by degree and order.

        `directions` are unit vectors. `inverse_concentration` is 1/kappa of the lobe, from 0 (no blur); a
        term of degree l is attenuated by exp(-l (l + 1) / (2 kappa)), the approximation of Ref-NeRF Eq. 8.
        """
        x, y, z = directions.unbind(dim=-1)
        chebyshev = [torch.ones_like(z), z]
        real, imaginary = [torch.ones_like(x)], [torch.zeros_like(x)]
        for _ in range(self.max_degree):
            chebyshev.append(2.0 * z * chebyshev[-1] - chebyshev[-2])
            real_part, imaginary_part = real[-1], imaginary[-1]
            real.append(real_part * x - imaginary_part * y)
            imaginary.append(real_part * y + imaginary_part * x)
        along_z = torch.stack(chebyshev[: self.max_degree + 1], dim=-1) @ self.polynomials
        attenuated = along_z * torch.exp(-self.rates * inverse_concentration)
        around_z = [torch.stack(part, dim=-1)[..., self.orders] for part in (real, imaginary)]
        return torch.cat([attenuated * part for part in around_z], dim=-1)


def _normalisation(degree: int, order: int) -> float:
    """Return the factor that makes a harmonic's square integrate to one over the sphere."""
    ratio = math.factorial(degree - order) / math.factorial(degree + order)
    return (-1) ** order * math.sqrt((2 * degree + 1) / (4.0 * math.pi) * ratio)
