"""Encodings of directions and positions by fixed functions: frequencies and integrated harmonics."""

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.polynomial import Chebyshev, Legendre
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from flashcache.kernels import dispatch


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

    polynomials: Tensor
    slopes: Tensor
    orders: Tensor
    rates: Tensor
    term_orders: Tensor

    def __init__(self, num_degrees: int) -> None:
        super().__init__()
        degrees = [2**i for i in range(num_degrees)]
        terms = [(degree, order) for degree in degrees for order in range(degree + 1)]
        self.max_degree = degrees[-1]
        self.out_features = 2 * len(terms)
        # In the Chebyshev basis the sums hardly cancel; in powers of z, degree 16 would lose five digits.
        matrix, slopes = np.zeros((2, self.max_degree + 1, len(terms)))
        for column, (degree, order) in enumerate(terms):
            polynomial = Legendre.basis(degree).convert(kind=Chebyshev).deriv(order)
            for target, series in ((matrix, polynomial), (slopes, polynomial.deriv())):
                target[: len(series.coef), column] = _normalisation(degree, order) * np.asarray(
                    series.coef, np.float64
                )
        orders = np.array([order for _, order in terms])
        constants = {
            "polynomials": matrix,
            "slopes": slopes,
            "orders": orders[None] == np.arange(self.max_degree + 1)[:, None],
            "rates": np.array([degree * (degree + 1) / 2 for degree, _ in terms]),
        }
        for name, values in constants.items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.float32), persistent=False)
        term_orders = torch.tensor([order for _, order in terms], dtype=torch.int32)
        self.register_buffer("term_orders", term_orders, persistent=False)

    def forward(
        self, directions: Float[Tensor, "*batch 3"], inverse_concentration: Float[Tensor, "*batch 1"]
    ) -> Float[Tensor, "*batch encoded"]:
        """Return all real parts, then all imaginary parts, by degree and order.

        `directions` are unit vectors. `inverse_concentration` is 1/kappa of the lobe, from 0 (no blur); a
        term of degree l is attenuated by exp(-l (l + 1) / (2 kappa)), the approximation of Ref-NeRF Eq. 8.
        It can be differentiated once.
        """
        if dispatch.is_fused(directions.device, directions.dtype):
            from flashcache.kernels import gpu_directional

            terms = gpu_directional.Terms(self.polynomials, self.slopes, self.rates, self.term_orders)
            return gpu_directional.encode(directions, inverse_concentration, terms)
        return _Encoded.apply(
            directions, inverse_concentration, self.polynomials, self.slopes, self.orders, self.rates
        )


class _Encoded(torch.autograd.Function):
    """The encoding with its derivatives written out: as a chain of small steps it costs twice as much."""

    @staticmethod
    def forward(ctx: Any, *inputs: Tensor) -> Tensor:
        directions, inverse_concentration, polynomials, slopes, orders, rates = inputs
        x, y, z = directions.unbind(dim=-1)
        chebyshev = _chebyshev(z, len(polynomials))
        real, imaginary = _powers(x, y, len(polynomials))
        along_z = chebyshev @ polynomials
        attenuation = torch.exp(-rates * inverse_concentration)
        attenuated = along_z * attenuation
        around_z = real @ orders, imaginary @ orders
        ctx.save_for_backward(
            chebyshev, real, imaginary, *around_z, along_z, attenuation, slopes, orders, rates
        )
        return torch.cat([attenuated * part for part in around_z], dim=-1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        chebyshev, real, imaginary, cosine, sine, along_z, attenuation, slopes, orders, rates = (
            ctx.saved_tensors
        )
        of_cosine, of_sine = gradient.chunk(2, dim=-1)
        of_attenuated = (of_cosine * cosine + of_sine * sine) * attenuation
        attenuated = along_z * attenuation
        # d (x + iy)^m = m (x + iy)^(m - 1) (dx + i dy)
        degree = torch.arange(1.0, real.shape[-1], device=real.device, dtype=real.dtype)
        of_real, of_imaginary = (
            ((part * attenuated) @ orders.T)[..., 1:] * degree for part in (of_cosine, of_sine)
        )
        below = real[..., :-1], imaginary[..., :-1]
        of_directions = [
            (of_real * below[0] + of_imaginary * below[1]).sum(dim=-1),
            (of_imaginary * below[0] - of_real * below[1]).sum(dim=-1),
            (of_attenuated * (chebyshev @ slopes)).sum(dim=-1),
        ]
        of_inverse = -((of_attenuated * along_z) @ rates)[..., None]
        return torch.stack(of_directions, dim=-1), of_inverse, None, None, None, None


def _powers(x: Tensor, y: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Return real and imaginary parts of (x + iy)^0 to (x + iy)^(count - 1), by b^(n + k) = b^n b^k."""
    real, imaginary = x[..., None], y[..., None]
    while real.shape[-1] < count - 1:
        top = real[..., -1:], imaginary[..., -1:]
        more = real * top[0] - imaginary * top[1], real * top[1] + imaginary * top[0]
        real, imaginary = torch.cat([real, more[0]], dim=-1), torch.cat([imaginary, more[1]], dim=-1)
    one = torch.ones_like(x)[..., None]
    return torch.cat([one, real], dim=-1), torch.cat([torch.zeros_like(one), imaginary], dim=-1)


def _chebyshev(z: Tensor, count: int) -> Tensor:
    """Return the Chebyshev polynomials T_0 to T_(count - 1), by T_(n + k) = 2 T_n T_k - T_(n - k)."""
    values = torch.stack([torch.ones_like(z), z], dim=-1)
    while values.shape[-1] < count:
        more = 2.0 * values[..., -1:] * values[..., 1:] - values[..., :-1].flip(-1)
        values = torch.cat([values, more], dim=-1)
    return values


def _normalisation(degree: int, order: int) -> float:
    """Return the factor that makes a harmonic's square integrate to one over the sphere."""
    ratio = math.factorial(degree - order) / math.factorial(degree + order)
    return (-1) ** order * math.sqrt((2 * degree + 1) / (4.0 * math.pi) * ratio)
